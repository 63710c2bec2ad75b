//! Programs: lists of simple operations on registers, each of which holds a number for every fragment of a block.

use std::sync::atomic::{AtomicU64, Ordering};

/// Turns that the loops of a function may take in all, for one fragment. Beyond that the result is NaN.
pub const MAX_ITERATIONS: u32 = 4096;

/// Functions of one number. Truths are the integers 0 and 1.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Unary {
    Negate,
    Abs,
    Sign,
    Floor,
    Ceil,
    Trunc,
    Round,
    Fract,
    Sqrt,
    InverseSqrt,
    Exp,
    Exp2,
    Log,
    Log2,
    Sin,
    Cos,
    Tan,
    Asin,
    Acos,
    Atan,
    Sinh,
    Cosh,
    Tanh,
    Asinh,
    Acosh,
    Atanh,
    QuantizeToF16,
    IntNegate,
    IntAbs,
    IntSign,
    Not,
    CountOneBits,
    CountLeadingZeros,
    CountTrailingZeros,
    ReverseBits,
    FirstLeadingBitI32,
    FirstLeadingBitU32,
    FirstTrailingBit,
    F32ToI32,
    F32ToU32,
    I32ToF32,
    U32ToF32,
    F32ToBool,
    IntToBool,
}

/// Functions of two numbers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Binary {
    Add,
    Subtract,
    Multiply,
    Divide,
    Remainder,
    Min,
    Max,
    Pow,
    Atan2,
    Ldexp,
    Equal,
    NotEqual,
    Less,
    LessEqual,
    IntAdd,
    IntSubtract,
    IntMultiply,
    I32Divide,
    I32Remainder,
    U32Divide,
    U32Remainder,
    And,
    Or,
    Xor,
    ShiftLeft,
    I32ShiftRight,
    U32ShiftRight,
    IntEqual,
    IntNotEqual,
    I32Less,
    I32LessEqual,
    U32Less,
    U32LessEqual,
    I32Min,
    I32Max,
    U32Min,
    U32Max,
}

/// One operation. `V` is what it reads: a register, or, while compiling, a number that may be known.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Op<V> {
    Unary {
        f: Unary,
        to: u32,
        a: V,
    },
    Binary {
        f: Binary,
        to: u32,
        a: V,
        b: V,
    },
    /// a^n.
    Power {
        n: i32,
        to: u32,
        a: V,
    },
    Select {
        to: u32,
        condition: V,
        accept: V,
        reject: V,
    },
    /// Reads a cell, the only thing that is ever written twice.
    Get {
        to: u32,
        cell: u32,
    },
    Set {
        cell: u32,
        value: V,
    },
    SetWhere {
        cell: u32,
        mask: V,
        value: V,
    },
    /// Goes on elsewhere if nobody needs what comes next.
    JumpUnlessAny {
        cell: u32,
        to: u32,
    },
    /// Ends a loop's turn, and goes back if anybody needs another. Those that have had too many leave the loop without
    /// a result.
    Repeat {
        cell: u32,
        to: u32,
    },
}

impl<V: Copy> Op<V> {
    /// The same operation on other operands and results.
    pub fn map<W>(self, mut read: impl FnMut(V) -> W, write: impl Fn(u32) -> u32) -> Op<W> {
        match self {
            Self::Unary { f, to, a } => Op::Unary { f, to: write(to), a: read(a) },
            Self::Binary { f, to, a, b } => Op::Binary { f, to: write(to), a: read(a), b: read(b) },
            Self::Power { n, to, a } => Op::Power { n, to: write(to), a: read(a) },
            Self::Select { to, condition, accept, reject } => Op::Select {
                to: write(to),
                condition: read(condition),
                accept: read(accept),
                reject: read(reject),
            },
            Self::Get { to, cell } => Op::Get { to: write(to), cell },
            Self::Set { cell, value } => Op::Set { cell, value: read(value) },
            Self::SetWhere { cell, mask, value } => {
                Op::SetWhere { cell, mask: read(mask), value: read(value) }
            }
            Self::JumpUnlessAny { cell, to } => Op::JumpUnlessAny { cell, to },
            Self::Repeat { cell, to } => Op::Repeat { cell, to },
        }
    }
}

/// A function that can be run. An operation reads registers before its own.
#[derive(Debug)]
pub struct Program {
    /// What tells it from all others.
    pub(super) id: u64,
    pub(super) ops: Vec<Op<u32>>,
    /// The first registers' values, as bits.
    pub(super) constants: Vec<u32>,
    /// Then the arguments.
    pub(super) inputs: usize,
    /// Registers in all.
    pub(super) registers: usize,
    pub(super) cells: usize,
    pub(super) result: u32,
}

impl Program {
    /// A program with an identity of its own.
    pub(super) fn new(
        ops: Vec<Op<u32>>,
        constants: Vec<u32>,
        inputs: usize,
        registers: usize,
        cells: usize,
        result: u32,
    ) -> Self {
        static NEXT: AtomicU64 = AtomicU64::new(1);
        let id = NEXT.fetch_add(1, Ordering::Relaxed);
        Self { id, ops, constants, inputs, registers, cells, result }
    }

    /// Whether two programs do the same, operation by operation.
    pub fn is_same(&self, other: &Self) -> bool {
        self.id == other.id
            || (self.ops == other.ops
                && self.constants == other.constants
                && self.inputs == other.inputs
                && self.result == other.result)
    }
}
