//! Runs programs, a block of fragments at a time: one operation for all of them, then the next.

use super::math;
use super::program::{Binary, MAX_ITERATIONS, Op, Program, Unary};
use half::f16;
use multiversion::multiversion;
use std::cell::RefCell;

/// Fragments of a vector, ...
const LANES: usize = 16;
/// ... vectors of a block, ...
const GROUPS: usize = 8;
/// ... and fragments of a block: many for what it costs to tell one operation from another, few enough for the registers
/// of a weight to stay in the nearest cache.
const BLOCK: usize = LANES * GROUPS;

type Lanes = [u32; LANES];
type Register = [Lanes; GROUPS];

/// A thread's working memory, kept for the next block.
#[derive(Default)]
struct Memory {
    /// Whose constants are in the registers.
    program: u64,
    registers: Vec<Register>,
    cells: Vec<Register>,
    loops: Loops,
}

/// What is known of the fragments' loops.
#[derive(Default)]
struct Loops {
    /// Turns so far.
    turns: Vec<Lanes>,
    /// Who has had too many.
    lost: Vec<Lanes>,
}

impl Memory {
    fn prepare(&mut self, program: &Program) {
        if self.program == program.id {
            return;
        }
        self.program = program.id;
        self.registers.clear();
        self.registers.extend(program.constants.iter().map(|&bits| [[bits; LANES]; GROUPS]));
        self.registers.resize(program.registers, [[0; LANES]; GROUPS]);
        self.cells.resize(program.cells, [[0; LANES]; GROUPS]);
    }
}

thread_local! {
    static MEMORY: RefCell<Memory> = RefCell::default();
}

impl Program {
    /// Writes `results[i] = f(inputs[0][i], inputs[1][i], ...)`. All slices have one length.
    pub fn run(&self, inputs: &[&[f32]], results: &mut [f32]) {
        assert_eq!(inputs.len(), self.inputs, "a program knows how many arguments it has");
        MEMORY.with(|memory| {
            let memory = &mut *memory.borrow_mut();
            memory.prepare(self);
            for (block, results) in results.chunks_mut(BLOCK).enumerate() {
                let place = block * BLOCK..block * BLOCK + results.len();
                for (i, input) in inputs.iter().enumerate() {
                    fill(&mut memory.registers[self.constants.len() + i], &input[place.clone()]);
                }
                self.run_block(memory, results);
            }
        });
    }

    fn run_block(&self, memory: &mut Memory, results: &mut [f32]) {
        let Memory { registers, cells, loops, .. } = memory;
        let groups = results.len().div_ceil(LANES);
        let has_loops = self.cells > 0;
        if has_loops {
            for counts in [&mut loops.turns, &mut loops.lost] {
                counts.clear();
                counts.resize(GROUPS, [0; LANES]);
            }
        }
        run_all(&self.ops, registers, cells, loops, groups);
        let result = registers[self.result as usize].as_flattened();
        results.iter_mut().zip(result).for_each(|(to, &bits)| *to = f32::from_bits(bits));
        if has_loops {
            let lost = loops.lost.as_flattened();
            let lost = results.iter_mut().zip(lost).filter(|(_, lost)| **lost != 0);
            lost.for_each(|(to, _)| *to = f32::NAN);
        }
    }

    /// What an operation on known numbers gives.
    pub(super) fn fold(op: Op<u32>, operands: &[u32]) -> u32 {
        let to = operands.len();
        let mut registers: Vec<Register> = operands.iter().map(|&bits| [[bits; LANES]; GROUPS]).collect();
        registers.push([[0; LANES]; GROUPS]);
        run_all(&[op], &mut registers, &mut [], &mut Loops::default(), 1);
        registers[to][0][0]
    }
}

/// A register with these values; the rest of its last vector repeats the last one, so that nothing is computed that
/// nobody asked for.
fn fill(register: &mut Register, values: &[f32]) {
    let lanes = register.as_flattened_mut();
    lanes.iter_mut().zip(values).for_each(|(lane, x)| *lane = x.to_bits());
    if let Some(last) = values.last() {
        lanes[values.len()..values.len().next_multiple_of(LANES)].fill(last.to_bits());
    }
}

#[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx512bw", "x86_64+avx2+fma"))]
fn run_all(
    ops: &[Op<u32>],
    registers: &mut [Register],
    cells: &mut [Register],
    loops: &mut Loops,
    groups: usize,
) {
    let mut at = 0;
    while let Some(&op) = ops.get(at) {
        at += 1;
        match op {
            Op::Unary { f, to, a } => unary(f, Place { registers, groups, to }, a),
            Op::Binary { f, to, a, b } => binary(f, Place { registers, groups, to }, a, b),
            Op::Power { n, to, a } => power(n, Place { registers, groups, to }, a),
            Op::Select { to, condition, accept, reject } => {
                select(Place { registers, groups, to }, condition, accept, reject);
            }
            Op::Get { to, cell } => {
                registers[to as usize][..groups].copy_from_slice(&cells[cell as usize][..groups]);
            }
            Op::Set { cell, value } => {
                cells[cell as usize][..groups].copy_from_slice(&registers[value as usize][..groups]);
            }
            Op::SetWhere { cell, mask, value } => {
                let (mask, value) = (&registers[mask as usize], &registers[value as usize]);
                for i in 0..groups {
                    let cell = &mut cells[cell as usize][i];
                    for lane in 0..LANES {
                        cell[lane] = if mask[i][lane] == 0 { cell[lane] } else { value[i][lane] };
                    }
                }
            }
            Op::JumpUnlessAny { cell, to } => {
                if !any(&cells[cell as usize][..groups]) {
                    at = to as usize;
                }
            }
            Op::Repeat { cell, to } => {
                let active = &mut cells[cell as usize][..groups];
                repeat(active, loops);
                if any(active) {
                    at = to as usize;
                }
            }
        }
    }
}

fn any(mask: &[Lanes]) -> bool {
    mask.as_flattened().iter().fold(0, |any, lane| any | lane) != 0
}

/// Counts a turn of those that are to have another one.
fn repeat(active: &mut [Lanes], loops: &mut Loops) {
    for ((active, turns), lost) in active.iter_mut().zip(&mut loops.turns).zip(&mut loops.lost) {
        for lane in 0..LANES {
            turns[lane] += active[lane];
            if turns[lane] >= MAX_ITERATIONS {
                lost[lane] |= active[lane];
                active[lane] = 0;
            }
        }
    }
}

/// A register to be written, and those before it.
struct Place<'r> {
    registers: &'r mut [Register],
    groups: usize,
    to: u32,
}

#[expect(clippy::inline_always, reason = "these take on their caller's instruction set")]
impl Place<'_> {
    #[inline(always)]
    fn map(self, a: u32, f: impl Fn(u32) -> u32) {
        let (before, after) = self.registers.split_at_mut(self.to as usize);
        let (to, a) = (&mut after[0][..self.groups], &before[a as usize][..self.groups]);
        for (to, a) in to.iter_mut().zip(a) {
            let (a, mut result) = (*a, [0; LANES]);
            for lane in 0..LANES {
                result[lane] = f(a[lane]);
            }
            *to = result;
        }
    }

    #[inline(always)]
    fn zip(self, a: u32, b: u32, f: impl Fn(u32, u32) -> u32) {
        let (before, after) = self.registers.split_at_mut(self.to as usize);
        let to = &mut after[0][..self.groups];
        let (a, b) = (&before[a as usize][..self.groups], &before[b as usize][..self.groups]);
        for ((to, a), b) in to.iter_mut().zip(a).zip(b) {
            let (a, b, mut result) = (*a, *b, [0; LANES]);
            for lane in 0..LANES {
                result[lane] = f(a[lane], b[lane]);
            }
            *to = result;
        }
    }

    #[inline(always)]
    fn floats(self, a: u32, f: impl Fn(f32) -> f32) {
        self.map(a, |a| f(f32::from_bits(a)).to_bits());
    }

    /// By way of f64, one by one.
    #[inline(always)]
    #[expect(clippy::cast_possible_truncation, reason = "rounding to f32 is the point")]
    fn doubles(self, a: u32, f: impl Fn(f64) -> f64) {
        self.floats(a, |x| f(f64::from(x)) as f32);
    }

    #[inline(always)]
    fn pairs(self, a: u32, b: u32, f: impl Fn(f32, f32) -> f32) {
        self.zip(a, b, |a, b| f(f32::from_bits(a), f32::from_bits(b)).to_bits());
    }

    #[inline(always)]
    fn compare(self, a: u32, b: u32, f: impl Fn(f32, f32) -> bool) {
        self.zip(a, b, |a, b| f(f32::from_bits(a), f32::from_bits(b)).into());
    }

    #[inline(always)]
    fn signed(self, a: u32, b: u32, f: impl Fn(i32, i32) -> i32) {
        self.zip(a, b, |a, b| f(a.cast_signed(), b.cast_signed()).cast_unsigned());
    }
}

#[inline(always)]
#[expect(clippy::inline_always, reason = "takes on its caller's instruction set")]
fn select(place: Place<'_>, condition: u32, accept: u32, reject: u32) {
    let Place { registers, groups, to } = place;
    let (before, after) = registers.split_at_mut(to as usize);
    let of = |register: u32| &before[register as usize][..groups];
    let to = &mut after[0][..groups];
    for (((to, c), a), r) in to.iter_mut().zip(of(condition)).zip(of(accept)).zip(of(reject)) {
        let (c, a, r, mut result) = (*c, *a, *r, [0; LANES]);
        for lane in 0..LANES {
            result[lane] = if c[lane] == 0 { r[lane] } else { a[lane] };
        }
        *to = result;
    }
}

#[inline(always)]
#[expect(clippy::inline_always, reason = "takes on its caller's instruction set")]
fn power(n: i32, place: Place<'_>, a: u32) {
    match n {
        2 => place.floats(a, |x| math::power(x, 2)),
        3 => place.floats(a, |x| math::power(x, 3)),
        4 => place.floats(a, |x| math::power(x, 4)),
        5 => place.floats(a, |x| math::power(x, 5)),
        6 => place.floats(a, |x| math::power(x, 6)),
        _ => place.floats(a, |x| math::power(x, n)),
    }
}

#[inline(always)]
#[expect(clippy::inline_always, reason = "takes on its caller's instruction set")]
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "conversions saturate")]
#[expect(clippy::cast_precision_loss, reason = "integers become the nearest f32")]
fn unary(f: Unary, place: Place<'_>, a: u32) {
    match f {
        Unary::Negate => place.floats(a, |x| -x),
        Unary::Abs => place.floats(a, f32::abs),
        Unary::Sign => place.floats(a, math::sign),
        Unary::Floor => place.floats(a, f32::floor),
        Unary::Ceil => place.floats(a, f32::ceil),
        Unary::Trunc => place.floats(a, f32::trunc),
        Unary::Round => place.floats(a, f32::round_ties_even),
        Unary::Fract => place.floats(a, |x| x - x.floor()),
        Unary::Sqrt => place.floats(a, f32::sqrt),
        Unary::InverseSqrt => place.doubles(a, |x| 1.0 / x.sqrt()),
        Unary::Exp => place.floats(a, math::exp),
        Unary::Exp2 => place.floats(a, math::exp2),
        Unary::Log => place.floats(a, math::log),
        Unary::Log2 => place.floats(a, math::log2),
        Unary::Sin => place.doubles(a, f64::sin),
        Unary::Cos => place.doubles(a, f64::cos),
        Unary::Tan => place.doubles(a, f64::tan),
        Unary::Asin => place.doubles(a, f64::asin),
        Unary::Acos => place.doubles(a, f64::acos),
        Unary::Atan => place.doubles(a, f64::atan),
        Unary::Sinh => place.doubles(a, f64::sinh),
        Unary::Cosh => place.doubles(a, f64::cosh),
        Unary::Tanh => place.doubles(a, f64::tanh),
        Unary::Asinh => place.doubles(a, f64::asinh),
        Unary::Acosh => place.doubles(a, f64::acosh),
        Unary::Atanh => place.doubles(a, f64::atanh),
        Unary::QuantizeToF16 => place.floats(a, |x| f16::from_f32(x).to_f32()),
        Unary::IntNegate => place.map(a, u32::wrapping_neg),
        Unary::IntAbs => place.map(a, |x| x.cast_signed().unsigned_abs()),
        Unary::IntSign => place.map(a, |x| x.cast_signed().signum().cast_unsigned()),
        Unary::Not => place.map(a, |x| !x),
        Unary::CountOneBits => place.map(a, u32::count_ones),
        Unary::CountLeadingZeros => place.map(a, u32::leading_zeros),
        Unary::CountTrailingZeros => place.map(a, u32::trailing_zeros),
        Unary::ReverseBits => place.map(a, u32::reverse_bits),
        Unary::FirstLeadingBitI32 => place.map(a, |x| math::first_leading_bit_i32(x.cast_signed())),
        Unary::FirstLeadingBitU32 => place.map(a, math::first_leading_bit_u32),
        Unary::FirstTrailingBit => place.map(a, math::first_trailing_bit),
        Unary::F32ToI32 => place.map(a, |x| (f32::from_bits(x) as i32).cast_unsigned()),
        Unary::F32ToU32 => place.map(a, |x| f32::from_bits(x) as u32),
        Unary::I32ToF32 => place.map(a, |x| (x.cast_signed() as f32).to_bits()),
        Unary::U32ToF32 => place.map(a, |x| (x as f32).to_bits()),
        Unary::F32ToBool => place.map(a, |x| (f32::from_bits(x) != 0.0).into()),
        Unary::IntToBool => place.map(a, |x| (x != 0).into()),
    }
}

#[inline(always)]
#[expect(clippy::inline_always, reason = "takes on its caller's instruction set")]
#[expect(clippy::cast_possible_truncation, reason = "rounding to f32 is the point")]
fn binary(f: Binary, place: Place<'_>, a: u32, b: u32) {
    match f {
        Binary::Add => place.pairs(a, b, |x, y| x + y),
        Binary::Subtract => place.pairs(a, b, |x, y| x - y),
        Binary::Multiply => place.pairs(a, b, |x, y| x * y),
        Binary::Divide => place.pairs(a, b, |x, y| x / y),
        Binary::Remainder => place.pairs(a, b, math::remainder),
        Binary::Min => place.pairs(a, b, math::min),
        Binary::Max => place.pairs(a, b, math::max),
        Binary::Pow => place.pairs(a, b, math::pow),
        Binary::Atan2 => place.pairs(a, b, |y, x| f64::from(y).atan2(x.into()) as f32),
        Binary::Ldexp => place.zip(a, b, |x, n| math::ldexp(f32::from_bits(x), n.cast_signed()).to_bits()),
        Binary::Equal => place.compare(a, b, |x, y| x == y),
        Binary::NotEqual => place.compare(a, b, |x, y| x != y),
        Binary::Less => place.compare(a, b, |x, y| x < y),
        Binary::LessEqual => place.compare(a, b, |x, y| x <= y),
        Binary::IntAdd => place.zip(a, b, u32::wrapping_add),
        Binary::IntSubtract => place.zip(a, b, u32::wrapping_sub),
        Binary::IntMultiply => place.zip(a, b, u32::wrapping_mul),
        Binary::I32Divide => place.signed(a, b, math::divide_i32),
        Binary::I32Remainder => place.signed(a, b, math::remainder_i32),
        Binary::U32Divide => place.zip(a, b, |x, y| x.checked_div(y).unwrap_or(x)),
        Binary::U32Remainder => place.zip(a, b, |x, y| x.checked_rem(y).unwrap_or(0)),
        Binary::And => place.zip(a, b, |x, y| x & y),
        Binary::Or => place.zip(a, b, |x, y| x | y),
        Binary::Xor => place.zip(a, b, |x, y| x ^ y),
        Binary::ShiftLeft => place.zip(a, b, u32::wrapping_shl),
        Binary::I32ShiftRight => {
            place.zip(a, b, |x, n| x.cast_signed().wrapping_shr(n).cast_unsigned());
        }
        Binary::U32ShiftRight => place.zip(a, b, u32::wrapping_shr),
        Binary::IntEqual => place.zip(a, b, |x, y| (x == y).into()),
        Binary::IntNotEqual => place.zip(a, b, |x, y| (x != y).into()),
        Binary::I32Less => place.signed(a, b, |x, y| (x < y).into()),
        Binary::I32LessEqual => place.signed(a, b, |x, y| (x <= y).into()),
        Binary::U32Less => place.zip(a, b, |x, y| (x < y).into()),
        Binary::U32LessEqual => place.zip(a, b, |x, y| (x <= y).into()),
        Binary::I32Min => place.signed(a, b, i32::min),
        Binary::I32Max => place.signed(a, b, i32::max),
        Binary::U32Min => place.zip(a, b, u32::min),
        Binary::U32Max => place.zip(a, b, u32::max),
    }
}
