//! Expressions, number by number.

use super::{Compiler, FALSE, Frame, Place, Problem, Val, Value};
use crate::own::program::{Binary, Unary};
use naga::{
    BinaryOperator, Expression, Handle, Literal, RelationalFunction, ScalarKind, Type, TypeInner,
    UnaryOperator,
};

type Numbers = Result<Vec<Val>, Problem>;

impl<'m> Compiler<'m> {
    /// What an expression stands for, computed now if it need not have been before.
    pub(super) fn value(
        &mut self,
        frame: &mut Frame<'m>,
        handle: Handle<Expression>,
    ) -> Result<Value, Problem> {
        if let Some(value) = &frame.values[handle.index()] {
            return Ok(value.clone());
        }
        let value = self.evaluate(frame, handle)?;
        if frame.function.expressions[handle].needs_pre_emit() {
            frame.values[handle.index()] = Some(value.clone());
        }
        Ok(value)
    }

    /// The numbers of an expression.
    pub(super) fn numbers(&mut self, frame: &mut Frame<'m>, handle: Handle<Expression>) -> Numbers {
        match self.value(frame, handle)? {
            Value::Numbers(numbers) => Ok(numbers),
            Value::Place(place) => Ok(self.load_from(place)),
        }
    }

    /// The variable that a pointer points to.
    pub(super) fn place(
        &mut self,
        frame: &mut Frame<'m>,
        handle: Handle<Expression>,
    ) -> Result<Place, Problem> {
        match self.value(frame, handle)? {
            Value::Place(place) => Ok(place),
            Value::Numbers(_) => {
                Err(Problem::at(Self::expression_span(frame, handle), "only variables can be written"))
            }
        }
    }

    fn load_from(&mut self, place: Place) -> Vec<Val> {
        let numbers = self.state.slots[place.slot..place.slot + place.len].to_vec();
        match place.index {
            None => numbers,
            Some(index) => vec![self.pick(&numbers, index)],
        }
    }

    /// One of some numbers.
    fn pick(&mut self, numbers: &[Val], index: Val) -> Val {
        let last = numbers.len() - 1;
        (0..last).rev().fold(numbers[last], |other, i| {
            let hit = self.is_index(index, i, numbers.len());
            self.select(hit, numbers[i], other)
        })
    }

    /// Whether an index is this one; what is beyond the last is the last.
    pub(super) fn is_index(&mut self, index: Val, i: usize, len: usize) -> Val {
        #[expect(clippy::cast_possible_truncation, reason = "at most MAX_COMPONENTS")]
        let i = Val::Known(i as u32);
        if i == Val::Known(0) || i != Val::Known(u32::try_from(len - 1).unwrap_or(u32::MAX)) {
            self.binary(Binary::IntEqual, index, i)
        } else {
            self.binary(Binary::U32LessEqual, i, index)
        }
    }

    /// Computes an expression.
    pub(super) fn evaluate(
        &mut self,
        frame: &mut Frame<'m>,
        handle: Handle<Expression>,
    ) -> Result<Value, Problem> {
        let span = Self::expression_span(frame, handle);
        let numbers = match &frame.function.expressions[handle] {
            Expression::FunctionArgument(i) => return Ok(frame.arguments[*i as usize].clone()),
            Expression::LocalVariable(local) => {
                let ty = frame.function.local_variables[*local].ty;
                let (slot, len) = (frame.locals[local.index()], self.components[ty.index()]);
                return Ok(Value::Place(Place { slot, len, index: None }));
            }
            Expression::AccessIndex { base, index } => return self.member(frame, *base, *index as usize),
            Expression::Access { base, index } => {
                let index = self.numbers(frame, *index)?[0];
                match self.value(frame, *base)? {
                    Value::Place(place) if place.index.is_none() => {
                        return Ok(Value::Place(Place { index: Some(index), ..place }));
                    }
                    Value::Place(_) => {
                        return Err(Problem::at(span, "an index of an index is not supported"));
                    }
                    Value::Numbers(numbers) => vec![self.pick(&numbers, index)],
                }
            }
            Expression::Load { pointer } => {
                let place = self.place(frame, *pointer)?;
                self.load_from(place)
            }
            Expression::Literal(literal) => vec![Self::literal(*literal, span)?],
            Expression::Constant(constant) => self.global(self.module.constants[*constant].init)?,
            Expression::ZeroValue(ty) => vec![FALSE; self.components[ty.index()]],
            Expression::Compose { components, .. } => {
                let mut all = Vec::new();
                for &component in components {
                    all.extend(self.numbers(frame, component)?);
                }
                all
            }
            Expression::Splat { size, value } => vec![self.numbers(frame, *value)?[0]; *size as usize],
            Expression::Swizzle { size, vector, pattern } => {
                let numbers = self.numbers(frame, *vector)?;
                pattern[..*size as usize].iter().map(|&component| numbers[component as usize]).collect()
            }
            Expression::Unary { op, expr } => self.operator(frame, *op, *expr)?,
            Expression::Binary { op, left, right } => self.operation(frame, *op, *left, *right)?,
            Expression::Select { condition, accept, reject } => {
                let condition = self.numbers(frame, *condition)?;
                let (accept, reject) = (self.numbers(frame, *accept)?, self.numbers(frame, *reject)?);
                let sides = accept.into_iter().zip(reject).enumerate();
                sides.map(|(i, (a, r))| self.select(condition[i % condition.len()], a, r)).collect()
            }
            Expression::Relational { fun, argument } => {
                let numbers = self.numbers(frame, *argument)?;
                let f = match fun {
                    RelationalFunction::All => Binary::And,
                    RelationalFunction::Any => Binary::Or,
                    _ => return Err(Problem::at(span, "this function is not supported")),
                };
                let (first, others) = numbers.split_first().unwrap_or((&FALSE, &[]));
                vec![others.iter().fold(*first, |all, &other| self.binary(f, all, other))]
            }
            Expression::Math { fun, arg, arg1, arg2, arg3 } => {
                let mut arguments = vec![self.numbers(frame, *arg)?];
                for more in [arg1, arg2, arg3].into_iter().flatten() {
                    arguments.push(self.numbers(frame, *more)?);
                }
                let kind = self.kind(frame, *arg);
                self.math(*fun, kind, &arguments, span)?
            }
            Expression::As { expr, kind, convert } => {
                let from = self.kind(frame, *expr);
                let numbers = self.numbers(frame, *expr)?;
                match convert {
                    None => numbers,
                    Some(_) => numbers.into_iter().map(|number| self.convert(number, from, *kind)).collect(),
                }
            }
            _ => return Err(Problem::at(span, "this expression is not supported here")),
        };
        Ok(Value::Numbers(numbers))
    }

    /// A member of a structure or a component of a vector, of a value or of a variable.
    fn member(
        &mut self,
        frame: &mut Frame<'m>,
        base: Handle<Expression>,
        index: usize,
    ) -> Result<Value, Problem> {
        let (first, len) = match self.inner(frame, base) {
            TypeInner::Struct { members, .. } => self.member_place(members, index),
            TypeInner::Pointer { base, .. } => match &self.module.types[*base].inner {
                TypeInner::Struct { members, .. } => self.member_place(members, index),
                _ => (index, 1),
            },
            _ => (index, 1),
        };
        Ok(match self.value(frame, base)? {
            Value::Numbers(numbers) => Value::Numbers(numbers[first..first + len].to_vec()),
            Value::Place(place) => Value::Place(Place { slot: place.slot + first, len, index: None }),
        })
    }

    fn member_place(&self, members: &[naga::StructMember], index: usize) -> (usize, usize) {
        let of = |ty: Handle<Type>| self.components[ty.index()];
        (members[..index].iter().map(|member| of(member.ty)).sum(), of(members[index].ty))
    }

    /// The type of an expression.
    fn inner<'f>(&'f self, frame: &'f Frame<'m>, handle: Handle<Expression>) -> &'f TypeInner {
        frame.info[handle].ty.inner_with(&self.module.types)
    }

    /// What kind of numbers an expression has.
    fn kind(&self, frame: &Frame<'m>, handle: Handle<Expression>) -> ScalarKind {
        let inner = self.inner(frame, handle);
        inner.scalar_kind().unwrap_or(ScalarKind::Float)
    }

    fn literal(literal: Literal, span: naga::Span) -> Result<Val, Problem> {
        Ok(Val::Known(match literal {
            Literal::F32(x) => x.to_bits(),
            Literal::U32(x) => x,
            Literal::I32(x) => x.cast_unsigned(),
            Literal::Bool(x) => x.into(),
            _ => return Err(Problem::at(span, "only f32, i32, u32 and bool are supported")),
        }))
    }

    /// A constant of the module.
    fn global(&mut self, handle: Handle<Expression>) -> Numbers {
        let span = self.module.global_expressions.get_span(handle);
        self.step(span)?;
        match &self.module.global_expressions[handle] {
            Expression::Literal(literal) => Ok(vec![Self::literal(*literal, span)?]),
            Expression::Constant(constant) => self.global(self.module.constants[*constant].init),
            Expression::ZeroValue(ty) => Ok(vec![FALSE; self.components[ty.index()]]),
            Expression::Splat { size, value } => Ok(vec![self.global(*value)?[0]; *size as usize]),
            Expression::Compose { components, .. } => {
                let mut all = Vec::new();
                for &component in components {
                    all.extend(self.global(component)?);
                }
                Ok(all)
            }
            _ => Err(Problem::at(span, "this constant is not supported")),
        }
    }

    fn operator(&mut self, frame: &mut Frame<'m>, op: UnaryOperator, expr: Handle<Expression>) -> Numbers {
        let kind = self.kind(frame, expr);
        let numbers = self.numbers(frame, expr)?;
        let apply = |number| match (op, kind) {
            (UnaryOperator::Negate, ScalarKind::Float) => self.unary(Unary::Negate, number),
            (UnaryOperator::Negate, _) => self.unary(Unary::IntNegate, number),
            (UnaryOperator::LogicalNot, _) | (UnaryOperator::BitwiseNot, ScalarKind::Bool) => {
                self.not(number)
            }
            (UnaryOperator::BitwiseNot, _) => self.unary(Unary::Not, number),
        };
        Ok(numbers.into_iter().map(apply).collect())
    }

    fn operation(
        &mut self,
        frame: &mut Frame<'m>,
        op: BinaryOperator,
        left: Handle<Expression>,
        right: Handle<Expression>,
    ) -> Numbers {
        let kind = self.kind(frame, left);
        let (left, right) = (self.numbers(frame, left)?, self.numbers(frame, right)?);
        // a vector goes with a scalar
        let pairs = 0..left.len().max(right.len());
        Ok(pairs.map(|i| self.operate(op, kind, left[i % left.len()], right[i % right.len()])).collect())
    }

    fn operate(&mut self, op: BinaryOperator, kind: ScalarKind, a: Val, b: Val) -> Val {
        use BinaryOperator as O;
        let is_float = kind == ScalarKind::Float;
        let is_signed = kind == ScalarKind::Sint;
        let of = |float, signed, unsigned| match kind {
            ScalarKind::Float => float,
            ScalarKind::Sint => signed,
            _ => unsigned,
        };
        let (f, a, b) = match op {
            O::Add => (if is_float { Binary::Add } else { Binary::IntAdd }, a, b),
            O::Subtract => (if is_float { Binary::Subtract } else { Binary::IntSubtract }, a, b),
            O::Multiply => (if is_float { Binary::Multiply } else { Binary::IntMultiply }, a, b),
            O::Divide => (of(Binary::Divide, Binary::I32Divide, Binary::U32Divide), a, b),
            O::Modulo => (of(Binary::Remainder, Binary::I32Remainder, Binary::U32Remainder), a, b),
            O::Equal => (if is_float { Binary::Equal } else { Binary::IntEqual }, a, b),
            O::NotEqual => (if is_float { Binary::NotEqual } else { Binary::IntNotEqual }, a, b),
            O::Less => (of(Binary::Less, Binary::I32Less, Binary::U32Less), a, b),
            O::LessEqual => (of(Binary::LessEqual, Binary::I32LessEqual, Binary::U32LessEqual), a, b),
            O::Greater => (of(Binary::Less, Binary::I32Less, Binary::U32Less), b, a),
            O::GreaterEqual => (of(Binary::LessEqual, Binary::I32LessEqual, Binary::U32LessEqual), b, a),
            O::And | O::LogicalAnd => (Binary::And, a, b),
            O::InclusiveOr | O::LogicalOr => (Binary::Or, a, b),
            O::ExclusiveOr => (Binary::Xor, a, b),
            O::ShiftLeft => (Binary::ShiftLeft, a, b),
            O::ShiftRight if is_signed => (Binary::I32ShiftRight, a, b),
            O::ShiftRight => (Binary::U32ShiftRight, a, b),
        };
        self.binary(f, a, b)
    }

    fn convert(&mut self, number: Val, from: ScalarKind, to: ScalarKind) -> Val {
        use ScalarKind as K;
        let f = match (from, to) {
            (K::Float, K::Sint) => Unary::F32ToI32,
            (K::Float, K::Uint) => Unary::F32ToU32,
            (K::Float, K::Bool) => Unary::F32ToBool,
            (K::Sint, K::Float) => Unary::I32ToF32,
            (K::Uint | K::Bool, K::Float) => Unary::U32ToF32,
            (K::Sint | K::Uint, K::Bool) => Unary::IntToBool,
            // the bits of integers and truths are the same
            _ => return number,
        };
        self.unary(f, number)
    }
}
