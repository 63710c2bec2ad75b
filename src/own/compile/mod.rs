//! From naga's IR to a program.
//!
//! Functions are inlined, vectors are so many numbers, and what depends on a condition is computed on both sides and
//! selected from: fragments of a block take different ways through a function. Only loops jump, back as long as any
//! fragment has a turn left; what changes in them lives in cells. What is known while compiling is computed then.

mod expressions;
mod math;
mod state;
mod statements;

use super::program::{Binary, Op, Program, Unary};
use super::report::Problem;
use naga::valid::{FunctionInfo, ModuleInfo};
use naga::{Expression, Function, Handle, Module, ScalarKind, Span, TypeInner};
use state::{Live, State};
use std::collections::HashMap;

/// Operations of a program; inlining could make any number of them.
const MAX_OPS: usize = 4096;
/// Statements and expressions that are looked at, though nothing may come of them.
const MAX_STEPS: usize = 100_000;
/// Blocks within blocks, calls included.
const MAX_DEPTH: usize = 200;
/// Numbers in a value.
const MAX_COMPONENTS: usize = 256;

/// A number: its bits if they are known, else the register that will hold it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub(super) enum Val {
    Known(u32),
    Register(u32),
}

const FALSE: Val = Val::Known(0);
const TRUE: Val = Val::Known(1);

/// What an expression stands for.
#[derive(Debug, Clone)]
enum Value {
    /// Its numbers.
    Numbers(Vec<Val>),
    /// Some of a variable's numbers.
    Place(Place),
}

/// Numbers of a variable: so many from a slot on, or the one of them that an index picks.
#[derive(Debug, Clone, Copy)]
struct Place {
    slot: usize,
    len: usize,
    index: Option<Val>,
}

/// A call that is being inlined.
struct Frame<'m> {
    function: &'m Function,
    info: &'m FunctionInfo,
    arguments: Vec<Value>,
    values: Vec<Option<Value>>,
    /// The first slot of each local variable.
    locals: Vec<usize>,
    /// The slots of what it returns.
    result: usize,
}

/// Compiles a function of these arguments, of which the first are to be read and the others have values.
///
/// # Errors
/// The first thing in it that cannot be run.
pub fn compile(
    module: &Module,
    info: &ModuleInfo,
    entry: Handle<Function>,
    inputs: &[&str],
    uniforms: &[(&str, f32)],
) -> Result<Program, Problem> {
    let mut compiler = Compiler::new(module, info, inputs.len())?;
    let arguments = module.functions[entry].arguments.iter().map(|argument| {
        let name = argument.name.as_deref().unwrap_or_default();
        let uniform = uniforms.iter().find(|(known, _)| *known == name);
        let input = inputs.iter().position(|known| *known == name);
        let number = match (input, uniform) {
            #[expect(clippy::cast_possible_truncation, reason = "a few arguments")]
            (Some(place), _) => Val::Register(place as u32),
            (None, Some((_, value))) => Val::Known(value.to_bits()),
            (None, None) => FALSE,
        };
        Value::Numbers(vec![number])
    });
    let arguments = arguments.collect();
    let result = compiler.call(entry, arguments)?;
    Ok(compiler.finish(inputs.len(), result[0]))
}

struct Compiler<'m> {
    module: &'m Module,
    info: &'m ModuleInfo,
    /// The numbers in a value of each type.
    components: Vec<usize>,
    ops: Vec<Op<Val>>,
    registers: u32,
    cells: u32,
    state: State,
    /// Which fragments are here, as far as conditions say, and loops.
    conditions: Vec<Val>,
    /// The loops and switches that statements are in, call by call.
    scopes: Vec<statements::Scope>,
    steps: usize,
    depth: usize,
}

impl<'m> Compiler<'m> {
    fn new(module: &'m Module, info: &'m ModuleInfo, inputs: usize) -> Result<Self, Problem> {
        #[expect(clippy::cast_possible_truncation, reason = "a few arguments")]
        let registers = inputs as u32;
        let mut compiler = Self {
            module,
            info,
            components: Vec::new(),
            ops: Vec::new(),
            registers,
            cells: 0,
            state: State::default(),
            conditions: Vec::new(),
            scopes: Vec::new(),
            steps: 0,
            depth: 0,
        };
        for (handle, ty) in module.types.iter() {
            let len = compiler.len_of(&ty.inner);
            let len = len.map_err(|message| Problem::at(module.types.get_span(handle), message))?;
            compiler.components.push(len);
        }
        Ok(compiler)
    }

    /// The numbers in a value of a type that is made of types that came before.
    fn len_of(&self, inner: &TypeInner) -> Result<usize, String> {
        let of = |scalar: naga::Scalar| match (scalar.kind, scalar.width) {
            (ScalarKind::Float | ScalarKind::Sint | ScalarKind::Uint, 4) | (ScalarKind::Bool, _) => Ok(1),
            _ => Err("only f32, i32, u32 and bool are supported".to_owned()),
        };
        match inner {
            TypeInner::Scalar(scalar) => of(*scalar),
            TypeInner::Vector { size, scalar } => of(*scalar).map(|_| *size as usize),
            TypeInner::Struct { members, .. } => {
                let len = members.iter().map(|m| self.components[m.ty.index()]).sum();
                if len > MAX_COMPONENTS {
                    return Err(format!("more than {MAX_COMPONENTS} numbers in a structure"));
                }
                Ok(len)
            }
            TypeInner::Pointer { .. } | TypeInner::ValuePointer { .. } => Ok(0),
            TypeInner::Matrix { .. } => Err("matrices are not supported".to_owned()),
            _ => Err("only scalars, vectors and structures of them are supported".to_owned()),
        }
    }

    /// The program, now that everything is known.
    fn finish(self, inputs: usize, result: Val) -> Program {
        let (mut constants, mut places) = (Vec::new(), HashMap::new());
        let mut known = |val: Val| {
            if let Val::Known(bits) = val {
                #[expect(clippy::cast_possible_truncation, reason = "at most three per operation")]
                places.entry(bits).or_insert_with(|| {
                    constants.push(bits);
                    constants.len() as u32 - 1
                });
            }
        };
        for op in &self.ops {
            op.map(&mut known, |to| to);
        }
        known(result);
        #[expect(clippy::cast_possible_truncation, reason = "at most three per operation")]
        let first = constants.len() as u32;
        let read = |val: Val| match val {
            Val::Known(bits) => places[&bits],
            Val::Register(register) => first + register,
        };
        let ops = self.ops.iter().map(|op| op.map(read, |to| first + to)).collect();
        let registers = (first + self.registers) as usize;
        Program::new(ops, constants, inputs, registers, self.cells as usize, read(result))
    }

    fn register(&mut self) -> u32 {
        self.registers += 1;
        self.registers - 1
    }

    fn cell(&mut self) -> u32 {
        self.cells += 1;
        self.cells - 1
    }

    /// Counts what is looked at.
    fn step(&mut self, span: Span) -> Result<(), Problem> {
        self.steps += 1;
        if self.steps > MAX_STEPS || self.ops.len() > MAX_OPS {
            let message = format!("the function is too long: more than {MAX_OPS} operations after inlining");
            return Err(Problem::at(span, message));
        }
        Ok(())
    }

    fn unary(&mut self, f: Unary, a: Val) -> Val {
        if let Val::Known(bits) = a {
            return Val::Known(Program::fold(Op::Unary { f, to: 1, a: 0 }, &[bits]));
        }
        let to = self.register();
        self.ops.push(Op::Unary { f, to, a });
        Val::Register(to)
    }

    fn binary(&mut self, f: Binary, a: Val, b: Val) -> Val {
        if let (Val::Known(x), Val::Known(y)) = (a, b) {
            return Val::Known(Program::fold(Op::Binary { f, to: 2, a: 0, b: 1 }, &[x, y]));
        }
        let to = self.register();
        self.ops.push(Op::Binary { f, to, a, b });
        Val::Register(to)
    }

    fn power(&mut self, a: Val, n: i32) -> Val {
        if let Val::Known(bits) = a {
            return Val::Known(Program::fold(Op::Power { n, to: 1, a: 0 }, &[bits]));
        }
        let to = self.register();
        self.ops.push(Op::Power { n, to, a });
        Val::Register(to)
    }

    fn select(&mut self, condition: Val, accept: Val, reject: Val) -> Val {
        match condition {
            _ if accept == reject => accept,
            Val::Known(0) => reject,
            Val::Known(_) => accept,
            Val::Register(_) if (accept, reject) == (TRUE, FALSE) => condition,
            Val::Register(_) => {
                let to = self.register();
                self.ops.push(Op::Select { to, condition, accept, reject });
                Val::Register(to)
            }
        }
    }

    fn get(&mut self, cell: u32) -> Val {
        let to = self.register();
        self.ops.push(Op::Get { to, cell });
        Val::Register(to)
    }

    /// Both of two truths.
    fn and(&mut self, a: Val, b: Val) -> Val {
        match (a, b) {
            (Val::Known(0), _) | (_, Val::Known(0)) => FALSE,
            (Val::Known(_), other) | (other, Val::Known(_)) => other,
            _ => self.binary(Binary::And, a, b),
        }
    }

    /// The other truth.
    fn not(&mut self, a: Val) -> Val {
        self.binary(Binary::Xor, a, TRUE)
    }

    /// Who is here: what conditions leave, and returns and jumps.
    fn path(&mut self) -> Val {
        let live = match self.state.live {
            Live::All => TRUE,
            Live::None => FALSE,
            Live::Some(mask) => mask,
        };
        self.conditions.clone().into_iter().fold(live, |path, condition| self.and(path, condition))
    }

    /// Inlines a call, and gives the numbers that it returns.
    fn call(&mut self, callee: Handle<Function>, arguments: Vec<Value>) -> Result<Vec<Val>, Problem> {
        let function = &self.module.functions[callee];
        let span = self.module.functions.get_span(callee);
        self.step(span)?;
        let (slots, live) = (self.state.slots.len(), self.state.live);
        let len = function.result.as_ref().map_or(0, |result| self.components[result.ty.index()]);
        let result = self.state.push(&vec![FALSE; len]);
        let mut frame = Frame {
            function,
            info: &self.info[callee],
            arguments,
            values: vec![None; function.expressions.len()],
            locals: Vec::new(),
            result,
        };
        for (_, local) in function.local_variables.iter() {
            let zeros = vec![FALSE; self.components[local.ty.index()]];
            frame.locals.push(self.state.push(&zeros));
        }
        for (i, (_, local)) in function.local_variables.iter().enumerate() {
            if let Some(init) = local.init {
                let numbers = self.numbers(&mut frame, init)?;
                self.state.slots[frame.locals[i]..][..numbers.len()].copy_from_slice(&numbers);
            }
        }
        self.scopes.push(statements::Scope::Call);
        self.block(&mut frame, &function.body)?;
        self.scopes.pop();
        self.state.live = live;
        let returned = self.state.slots[result..result + len].to_vec();
        self.state.slots.truncate(slots);
        Ok(returned)
    }

    fn expression_span(frame: &Frame<'_>, handle: Handle<Expression>) -> Span {
        frame.function.expressions.get_span(handle)
    }
}
