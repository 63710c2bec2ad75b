//! WGSL's functions in terms of the program's.

use super::{Compiler, FALSE, Problem, Val};
use crate::own::program::{Binary, Unary};
use naga::{MathFunction, ScalarKind, Span};
use std::f32::consts::PI;

/// Exponents that are taken by multiplication.
const MAX_POWER: f32 = 64.0;

fn f32_val(x: f32) -> Val {
    Val::Known(x.to_bits())
}

impl Compiler<'_> {
    /// A function of numbers or vectors.
    pub(super) fn math(
        &mut self,
        fun: MathFunction,
        kind: ScalarKind,
        arguments: &[Vec<Val>],
        span: Span,
    ) -> Result<Vec<Val>, Problem> {
        use MathFunction as M;
        let whole = match fun {
            M::Dot => Some(vec![self.dot(kind, &arguments[0], &arguments[1])]),
            M::Length => Some(vec![self.length(&arguments[0])]),
            M::Distance => {
                let difference =
                    self.each(&[&arguments[0], &arguments[1]], |c, x| c.binary(Binary::Subtract, x[0], x[1]));
                Some(vec![self.length(&difference)])
            }
            M::Normalize => {
                let length = self.length(&arguments[0]);
                Some(self.each(&[&arguments[0]], |c, x| c.binary(Binary::Divide, x[0], length)))
            }
            M::Cross => Some(self.cross(&arguments[0], &arguments[1])),
            M::FaceForward => {
                let dot = self.dot(kind, &arguments[1], &arguments[2]);
                let is_front = self.binary(Binary::Less, dot, f32_val(0.0));
                Some(self.each(&[&arguments[0]], |c, x| {
                    let turned = c.unary(Unary::Negate, x[0]);
                    c.select(is_front, x[0], turned)
                }))
            }
            M::Reflect => {
                let dot = self.dot(kind, &arguments[1], &arguments[0]);
                let twice = self.binary(Binary::Multiply, f32_val(2.0), dot);
                Some(self.each(&[&arguments[0], &arguments[1]], |c, x| {
                    let along = c.binary(Binary::Multiply, twice, x[1]);
                    c.binary(Binary::Subtract, x[0], along)
                }))
            }
            M::Modf => {
                // a structure: the fraction, then the whole part
                let whole = self.each(&[&arguments[0]], |c, x| c.unary(Unary::Trunc, x[0]));
                let mut parts =
                    self.each(&[&arguments[0], &whole], |c, x| c.binary(Binary::Subtract, x[0], x[1]));
                parts.extend(whole);
                Some(parts)
            }
            _ => None,
        };
        if let Some(numbers) = whole {
            return Ok(numbers);
        }
        let len = arguments.iter().map(Vec::len).max().unwrap_or(0);
        let of = |i: usize| arguments.iter().map(|numbers| numbers[i % numbers.len()]).collect::<Vec<_>>();
        let numbers: Option<Vec<_>> = (0..len).map(|i| self.scalar(fun, kind, &of(i))).collect();
        numbers.ok_or_else(|| Problem::at(span, "this function is not supported here"))
    }

    /// The same of each component.
    fn each(&mut self, vectors: &[&[Val]], mut f: impl FnMut(&mut Self, &[Val]) -> Val) -> Vec<Val> {
        let of = |i: usize| vectors.iter().map(|vector| vector[i]).collect::<Vec<_>>();
        (0..vectors[0].len()).map(|i| f(self, &of(i))).collect()
    }

    fn dot(&mut self, kind: ScalarKind, a: &[Val], b: &[Val]) -> Val {
        let (times, plus) = match kind {
            ScalarKind::Float => (Binary::Multiply, Binary::Add),
            _ => (Binary::IntMultiply, Binary::IntAdd),
        };
        let products = self.each(&[a, b], |c, x| c.binary(times, x[0], x[1]));
        products.into_iter().reduce(|sum, product| self.binary(plus, sum, product)).unwrap_or(FALSE)
    }

    fn length(&mut self, a: &[Val]) -> Val {
        if let [x] = a {
            return self.unary(Unary::Abs, *x);
        }
        let square = self.dot(ScalarKind::Float, a, a);
        self.unary(Unary::Sqrt, square)
    }

    fn cross(&mut self, a: &[Val], b: &[Val]) -> Vec<Val> {
        let component = |i: usize| ((i + 1) % 3, (i + 2) % 3);
        let component = |c: &mut Self, i| {
            let (j, k) = component(i);
            let first = c.binary(Binary::Multiply, a[j], b[k]);
            let second = c.binary(Binary::Multiply, a[k], b[j]);
            c.binary(Binary::Subtract, first, second)
        };
        (0..3).map(|i| component(self, i)).collect()
    }

    /// A function of numbers, if it is one.
    fn scalar(&mut self, fun: MathFunction, kind: ScalarKind, x: &[Val]) -> Option<Val> {
        use MathFunction as M;
        let is_float = kind == ScalarKind::Float;
        let (min, max) = match kind {
            ScalarKind::Float => (Binary::Min, Binary::Max),
            ScalarKind::Sint => (Binary::I32Min, Binary::I32Max),
            _ => (Binary::U32Min, Binary::U32Max),
        };
        Some(match fun {
            M::Abs if is_float => self.unary(Unary::Abs, x[0]),
            M::Abs if kind == ScalarKind::Sint => self.unary(Unary::IntAbs, x[0]),
            M::Abs => x[0],
            M::Sign => self.unary(if is_float { Unary::Sign } else { Unary::IntSign }, x[0]),
            M::Min => self.binary(min, x[0], x[1]),
            M::Max => self.binary(max, x[0], x[1]),
            M::Clamp => {
                let raised = self.binary(max, x[0], x[1]);
                self.binary(min, raised, x[2])
            }
            M::Saturate => {
                let raised = self.binary(Binary::Max, x[0], f32_val(0.0));
                self.binary(Binary::Min, raised, f32_val(1.0))
            }
            M::Radians => self.binary(Binary::Multiply, x[0], f32_val(PI / 180.0)),
            M::Degrees => self.binary(Binary::Multiply, x[0], f32_val(180.0 / PI)),
            M::Atan2 => self.binary(Binary::Atan2, x[0], x[1]),
            M::Pow => self.raise(x[0], x[1]),
            M::Ldexp => self.binary(Binary::Ldexp, x[0], x[1]),
            M::Fma => {
                let product = self.binary(Binary::Multiply, x[0], x[1]);
                self.binary(Binary::Add, product, x[2])
            }
            M::Mix => {
                let other = self.binary(Binary::Subtract, f32_val(1.0), x[2]);
                let first = self.binary(Binary::Multiply, x[0], other);
                let second = self.binary(Binary::Multiply, x[1], x[2]);
                self.binary(Binary::Add, first, second)
            }
            M::Step => {
                let reached = self.binary(Binary::LessEqual, x[0], x[1]);
                self.select(reached, f32_val(1.0), f32_val(0.0))
            }
            M::SmoothStep => self.smooth_step(x[0], x[1], x[2]),
            _ => self.unary(unary(fun, kind)?, x[0]),
        })
    }

    /// By multiplication where the exponent is known to be small and whole.
    fn raise(&mut self, base: Val, exponent: Val) -> Val {
        if let Val::Known(bits) = exponent {
            let n = f32::from_bits(bits);
            #[expect(clippy::cast_possible_truncation, reason = "small and whole")]
            match n {
                0.5 => return self.unary(Unary::Sqrt, base),
                _ if n.trunc() == n && n.abs() <= MAX_POWER => return self.power(base, n as i32),
                _ => {}
            }
        }
        self.binary(Binary::Pow, base, exponent)
    }

    fn smooth_step(&mut self, low: Val, high: Val, x: Val) -> Val {
        let above = self.binary(Binary::Subtract, x, low);
        let width = self.binary(Binary::Subtract, high, low);
        let t = self.binary(Binary::Divide, above, width);
        let t = self.binary(Binary::Max, t, f32_val(0.0));
        let t = self.binary(Binary::Min, t, f32_val(1.0));
        let twice = self.binary(Binary::Multiply, f32_val(2.0), t);
        let slope = self.binary(Binary::Subtract, f32_val(3.0), twice);
        let square = self.binary(Binary::Multiply, t, t);
        self.binary(Binary::Multiply, square, slope)
    }
}

/// The functions of one number that the program has itself.
fn unary(fun: MathFunction, kind: ScalarKind) -> Option<Unary> {
    use MathFunction as M;
    Some(match fun {
        M::Cos => Unary::Cos,
        M::Cosh => Unary::Cosh,
        M::Sin => Unary::Sin,
        M::Sinh => Unary::Sinh,
        M::Tan => Unary::Tan,
        M::Tanh => Unary::Tanh,
        M::Acos => Unary::Acos,
        M::Asin => Unary::Asin,
        M::Atan => Unary::Atan,
        M::Asinh => Unary::Asinh,
        M::Acosh => Unary::Acosh,
        M::Atanh => Unary::Atanh,
        M::Ceil => Unary::Ceil,
        M::Floor => Unary::Floor,
        M::Round => Unary::Round,
        M::Fract => Unary::Fract,
        M::Trunc => Unary::Trunc,
        M::Exp => Unary::Exp,
        M::Exp2 => Unary::Exp2,
        M::Log => Unary::Log,
        M::Log2 => Unary::Log2,
        M::Sqrt => Unary::Sqrt,
        M::InverseSqrt => Unary::InverseSqrt,
        M::QuantizeToF16 => Unary::QuantizeToF16,
        M::CountTrailingZeros => Unary::CountTrailingZeros,
        M::CountLeadingZeros => Unary::CountLeadingZeros,
        M::CountOneBits => Unary::CountOneBits,
        M::ReverseBits => Unary::ReverseBits,
        M::FirstTrailingBit => Unary::FirstTrailingBit,
        M::FirstLeadingBit if kind == ScalarKind::Sint => Unary::FirstLeadingBitI32,
        M::FirstLeadingBit => Unary::FirstLeadingBitU32,
        _ => return None,
    })
}
