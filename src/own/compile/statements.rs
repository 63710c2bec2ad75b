//! Statements: what changes variables, and the ways through a function.

use super::state::{Live, State};
use super::{Compiler, FALSE, Frame, MAX_DEPTH, Place, Problem, TRUE, Val, Value};
use crate::own::program::{Binary, Op};
use naga::{Block, Expression, Handle, Span, Statement, SwitchCase, SwitchValue};

/// What a jump may lead out of.
pub(super) enum Scope {
    /// A call.
    Call,
    /// A switch, with the slot that says who has left it.
    Switch { left: usize },
    /// A loop.
    Loop(Loop),
}

/// A loop that is being compiled.
#[derive(Clone)]
pub(super) struct Loop {
    /// The cells of all variables, one after the other from here ...
    cells: u32,
    /// ... and their numbers as a turn has found them.
    found: Vec<Val>,
    /// The cell of those who are in it, and of those who have left the function from within.
    active: u32,
    gone: u32,
    /// Whether anybody can ever leave.
    ends: bool,
    /// Whether anybody leaves the function.
    returns: bool,
}

impl<'m> Compiler<'m> {
    pub(super) fn block(&mut self, frame: &mut Frame<'m>, block: &'m Block) -> Result<(), Problem> {
        self.depth += 1;
        if self.depth > MAX_DEPTH {
            return Err(Problem::new(format!("more than {MAX_DEPTH} blocks and calls within each other")));
        }
        for (statement, span) in block.span_iter() {
            if self.state.live == Live::None {
                break;
            }
            self.step(*span)?;
            self.statement(frame, statement, *span)?;
        }
        self.depth -= 1;
        Ok(())
    }

    fn statement(
        &mut self,
        frame: &mut Frame<'m>,
        statement: &'m Statement,
        span: Span,
    ) -> Result<(), Problem> {
        match statement {
            Statement::Emit(range) => {
                for handle in range.clone() {
                    self.step(span)?;
                    let value = self.evaluate(frame, handle)?;
                    frame.values[handle.index()] = Some(value);
                }
                Ok(())
            }
            Statement::Block(block) => self.block(frame, block),
            Statement::If { condition, accept, reject } => {
                let condition = self.numbers(frame, *condition)?[0];
                self.branch(condition, &mut |compiler, side| {
                    compiler.block(frame, if side { accept } else { reject })
                })
            }
            Statement::Switch { selector, cases } => self.switch(frame, *selector, cases),
            Statement::Loop { body, continuing, break_if } => {
                self.repeat(frame, body, continuing, *break_if, span)
            }
            Statement::Break => self.leave_innermost(),
            Statement::Continue => self.go_on(),
            Statement::Return { value } => {
                let numbers = value.map(|value| self.numbers(frame, value)).transpose()?.unwrap_or_default();
                for (i, number) in numbers.into_iter().enumerate() {
                    self.store(frame.result + i, number);
                }
                self.leave_function();
                Ok(())
            }
            Statement::Store { pointer, value } => {
                let numbers = self.numbers(frame, *value)?;
                let place = self.place(frame, *pointer)?;
                self.store_at(place, &numbers);
                Ok(())
            }
            Statement::Call { function, arguments, result } => {
                let values = arguments.iter().map(|&argument| self.value(frame, argument));
                let values = values.collect::<Result<_, _>>()?;
                let returned = self.call(*function, values)?;
                if let Some(result) = result {
                    frame.values[result.index()] = Some(Value::Numbers(returned));
                }
                Ok(())
            }
            _ => Err(Problem::at(span, "this statement is not supported here")),
        }
    }

    fn store_at(&mut self, place: Place, numbers: &[Val]) {
        let Some(index) = place.index else {
            for (i, &number) in numbers.iter().enumerate() {
                self.store(place.slot + i, number);
            }
            return;
        };
        for i in 0..place.len {
            let hit = self.is_index(index, i, place.len);
            let kept = self.state.slots[place.slot + i];
            let number = self.select(hit, numbers[0], kept);
            self.store(place.slot + i, number);
        }
    }

    /// Compiles one or both of two ways.
    fn branch(
        &mut self,
        condition: Val,
        side: &mut dyn FnMut(&mut Self, bool) -> Result<(), Problem>,
    ) -> Result<(), Problem> {
        if let Val::Known(known) = condition {
            return side(self, known != 0);
        }
        let before = self.state.clone();
        self.conditions.push(condition);
        side(self, true)?;
        self.conditions.pop();
        let accepted = std::mem::replace(&mut self.state, before);
        let other = self.not(condition);
        self.conditions.push(other);
        side(self, false)?;
        self.conditions.pop();
        let rejected = std::mem::take(&mut self.state);
        self.state = self.merge(condition, accepted, &rejected);
        Ok(())
    }

    fn switch(
        &mut self,
        frame: &mut Frame<'m>,
        selector: Handle<Expression>,
        cases: &'m [SwitchCase],
    ) -> Result<(), Problem> {
        let selector = self.numbers(frame, selector)?[0];
        let live = self.state.live;
        let left = self.state.push(&[FALSE]);
        self.scopes.push(Scope::Switch { left });
        let ways = self.ways(selector, cases);
        let default = cases.iter().position(|case| matches!(case.value, SwitchValue::Default));
        self.case(frame, &ways, default.map(|at| body_of(cases, at)))?;
        self.scopes.pop();
        // those who have left it go on behind it
        let left = self.state.slots[left];
        self.state.slots.pop();
        self.state.live = match (self.state.live, left) {
            (Live::All, _) => Live::All,
            (_, FALSE) => self.state.live,
            (Live::None, left) => Live::from_mask(left),
            (Live::Some(mask), left) => Live::from_mask(self.binary(Binary::Or, mask, left)),
        };
        if live == Live::None {
            self.state.live = live;
        }
        Ok(())
    }

    /// Who goes where: a condition for each case but the default.
    fn ways(&mut self, selector: Val, cases: &'m [SwitchCase]) -> Vec<(Val, &'m Block)> {
        let mut ways = Vec::new();
        for (at, case) in cases.iter().enumerate() {
            let value = match case.value {
                SwitchValue::I32(value) => value.cast_unsigned(),
                SwitchValue::U32(value) => value,
                SwitchValue::Default => continue,
            };
            let is_here = self.binary(Binary::IntEqual, selector, Val::Known(value));
            ways.push((is_here, body_of(cases, at)));
        }
        ways
    }

    fn case(
        &mut self,
        frame: &mut Frame<'m>,
        ways: &[(Val, &'m Block)],
        default: Option<&'m Block>,
    ) -> Result<(), Problem> {
        let Some(((condition, body), others)) = ways.split_first() else {
            return default.map_or(Ok(()), |body| self.block(frame, body));
        };
        self.depth += 1;
        if self.depth > MAX_DEPTH {
            return Err(Problem::new(format!(
                "more than {MAX_DEPTH} cases, blocks and calls within each other"
            )));
        }
        self.branch(*condition, &mut |compiler, is_here| {
            if is_here { compiler.block(frame, body) } else { compiler.case(frame, others, default) }
        })?;
        self.depth -= 1;
        Ok(())
    }

    fn leave_innermost(&mut self) -> Result<(), Problem> {
        match self.scopes.last() {
            Some(Scope::Switch { left }) => {
                let left = *left;
                self.store(left, TRUE);
            }
            Some(Scope::Loop(_)) => {
                let at = self.scopes.len() - 1;
                let path = self.path();
                self.save(at, path);
                let Loop { active, .. } = *self.loop_at(at);
                self.ops.push(Op::SetWhere { cell: active, mask: path, value: FALSE });
                self.loop_at(at).ends = true;
            }
            _ => return Err(Problem::new("a break outside of loops and switches")),
        }
        self.state.live = Live::None;
        Ok(())
    }

    /// Leaves this turn of the innermost loop.
    fn go_on(&mut self) -> Result<(), Problem> {
        let Some(at) = self.scopes.iter().rposition(|scope| matches!(scope, Scope::Loop(_))) else {
            return Err(Problem::new("a continue outside of loops"));
        };
        let path = self.path();
        self.save(at, path);
        self.state.live = Live::None;
        Ok(())
    }

    /// Leaves the function, and the innermost of its loops if there is one, which tells the others.
    fn leave_function(&mut self) {
        let in_call = self.scopes.iter().rev().take_while(|scope| !matches!(scope, Scope::Call));
        let inner = in_call.enumerate().find(|(_, scope)| matches!(scope, Scope::Loop(_)));
        if let Some((back, _)) = inner {
            let at = self.scopes.len() - 1 - back;
            let path = self.path();
            self.save(at, path);
            let Loop { active, gone, .. } = *self.loop_at(at);
            self.ops.push(Op::SetWhere { cell: active, mask: path, value: FALSE });
            self.ops.push(Op::SetWhere { cell: gone, mask: path, value: TRUE });
            let inner = self.loop_at(at);
            (inner.ends, inner.returns) = (true, true);
        }
        self.state.live = Live::None;
    }

    fn loop_at(&mut self, at: usize) -> &mut Loop {
        match &mut self.scopes[at] {
            Scope::Loop(inner) => inner,
            _ => unreachable!("the place of a loop"),
        }
    }

    /// Writes what has changed to a loop's cells, for some.
    fn save(&mut self, at: usize, mask: Val) {
        let Loop { cells, found, .. } = self.loop_at(at).clone();
        for ((cell, found), &value) in (cells..).zip(found).zip(&self.state.slots) {
            if found != value {
                self.ops.push(Op::SetWhere { cell, mask, value });
            }
        }
    }

    fn load(&mut self, cells: u32, count: usize) -> Vec<Val> {
        (cells..).take(count).map(|cell| self.get(cell)).collect()
    }

    #[expect(clippy::cast_possible_truncation, reason = "at most MAX_OPS operations")]
    fn repeat(
        &mut self,
        frame: &mut Frame<'m>,
        body: &'m Block,
        continuing: &'m Block,
        break_if: Option<Handle<Expression>>,
        span: Span,
    ) -> Result<(), Problem> {
        let path = self.path();
        if path == FALSE {
            return Ok(());
        }
        let (live, count) = (self.state.live, self.state.slots.len());
        let cells = self.cells;
        self.cells += count as u32;
        let (active, gone) = (self.cell(), self.cell());
        for (cell, &value) in (cells..).zip(&self.state.slots) {
            self.ops.push(Op::Set { cell, value });
        }
        self.ops.push(Op::Set { cell: active, value: path });
        self.ops.push(Op::Set { cell: gone, value: FALSE });
        let jump = self.ops.len();
        self.ops.push(Op::JumpUnlessAny { cell: active, to: 0 });

        let top = self.ops.len() as u32;
        let outside = std::mem::take(&mut self.conditions);
        let found = self.load(cells, count);
        let here = self.get(active);
        self.state = State { slots: found.clone(), live: Live::All };
        self.conditions = vec![here];
        self.scopes.push(Scope::Loop(Loop { cells, found, active, gone, ends: false, returns: false }));
        let at = self.scopes.len() - 1;
        self.block(frame, body)?;
        let fall_through = self.path();
        if fall_through != FALSE {
            self.save(at, fall_through);
        }
        self.continuing(frame, at, continuing, break_if)?;
        let Some(Scope::Loop(Loop { ends, returns, .. })) = self.scopes.pop() else {
            unreachable!("the loop that was pushed");
        };
        if !ends {
            return Err(Problem::at(span, "this loop never ends"));
        }
        self.ops.push(Op::Repeat { cell: active, to: top });
        let end = self.ops.len() as u32;
        self.ops[jump] = Op::JumpUnlessAny { cell: active, to: end };

        self.conditions = outside;
        self.state = State { slots: self.load(cells, count), live };
        if returns {
            self.return_those(gone);
        }
        Ok(())
    }

    /// What comes between two turns.
    fn continuing(
        &mut self,
        frame: &mut Frame<'m>,
        at: usize,
        block: &'m Block,
        break_if: Option<Handle<Expression>>,
    ) -> Result<(), Problem> {
        if block.is_empty() && break_if.is_none() {
            return Ok(());
        }
        let Loop { cells, found, active, .. } = self.loop_at(at).clone();
        let here = self.get(active);
        let found = self.load(cells, found.len());
        self.state = State { slots: found.clone(), live: Live::All };
        self.conditions = vec![here];
        self.loop_at(at).found = found;
        self.block(frame, block)?;
        let path = self.path();
        self.save(at, path);
        if let Some(condition) = break_if {
            let condition = self.numbers(frame, condition)?[0];
            let mask = self.and(path, condition);
            if mask != FALSE {
                self.ops.push(Op::SetWhere { cell: active, mask, value: FALSE });
                self.loop_at(at).ends = true;
            }
        }
        Ok(())
    }

    /// After a loop: those who have left the function from within are no longer there.
    fn return_those(&mut self, gone: u32) {
        let gone = self.get(gone);
        let stay = self.not(gone);
        let live = self.state.live;
        self.conditions.push(gone);
        self.leave_function();
        self.conditions.pop();
        self.state.live = match live {
            Live::All => Live::Some(stay),
            Live::None => Live::None,
            Live::Some(mask) => Live::from_mask(self.and(mask, stay)),
        };
    }
}

/// The body of a case that may be shared with those that follow.
fn body_of(cases: &[SwitchCase], at: usize) -> &Block {
    let shared = cases[at..].iter().position(|case| !case.fall_through).unwrap_or(0);
    &cases[at + shared].body
}
