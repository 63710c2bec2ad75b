//! Programs against what WGSL says they are.

#![expect(clippy::cast_possible_truncation, reason = "what WGSL does with these casts is what is tested")]
#![expect(clippy::cast_precision_loss, reason = "what WGSL does with these casts is what is tested")]
#![expect(clippy::cast_sign_loss, reason = "what WGSL does with these casts is what is tested")]

use super::*;

static SIGNATURE: Signature = Signature { entry: "f", arguments: &["x", "y"], callable: "(x, y) -> f" };

fn parse(text: &str) -> Source {
    Source::parse(text, &SIGNATURE).unwrap_or_else(|shown| panic!("{shown}"))
}

/// f at many places, which are more than a block.
fn run(text: &str, uniforms: &[f32], at: &[(f32, f32)]) -> Vec<f32> {
    let program = parse(text).compile(uniforms).unwrap_or_else(|shown| panic!("{shown}"));
    let (x, y): (Vec<_>, Vec<_>) = at.iter().copied().unzip();
    let mut results = vec![0.0; at.len()];
    program.run(&[&x, &y], &mut results);
    results
}

fn places() -> Vec<(f32, f32)> {
    (0..300_u16).map(|i| (f32::from(i) * 0.25 - 20.0, f32::from(i % 7) + 0.5)).collect()
}

/// The text is the function, to the bit.
#[track_caller]
fn is(text: &str, function: impl Fn(f32, f32) -> f32) {
    let places = places();
    for (&(x, y), got) in places.iter().zip(run(text, &[], &places)) {
        let expected = function(x, y);
        let same =
            got.to_bits() == expected.to_bits() || (got.is_nan() && expected.is_nan()) || got == expected;
        assert!(same, "{text} at {x}, {y}: {got} for {expected}");
    }
}

/// What is wrong with a text.
fn refusal(text: &str) -> String {
    match Source::parse(text, &SIGNATURE) {
        Err(shown) => shown,
        Ok(source) => source.compile(&vec![1.0; source.uniforms().len()]).expect_err(text),
    }
}

#[test]
fn expressions_are_rounded_operation_by_operation() {
    is("x * y + 0.1", |x, y| x * y + 0.1);
    is("(x - y) / (y + 1) % 3", |x, y| math::remainder((x - y) / (y + 1.0), 3.0));
    is("-abs(x) + sign(x) * fract(y) - round(x)", |x, y| {
        -x.abs() + math::sign(x) * (y - y.floor()) - x.round_ties_even()
    });
    is("mix(x, y, 0.3)", |x, y| x * (1.0 - 0.3) + y * 0.3);
    is("step(2.0, x) + saturate(y / 4)", |x, y| f32::from(u8::from(2.0 <= x)) + (y / 4.0).clamp(0.0, 1.0));
    is("smoothstep(-1.0, 3.0, x)", |x, _| {
        let t = ((x + 1.0) / 4.0).clamp(0.0, 1.0);
        t * t * (3.0 - 2.0 * t)
    });
    is("fma(x, y, 1.0) + floor(x) - ceil(x) * trunc(y)", |x, y| {
        x * y + 1.0 + x.floor() - x.ceil() * y.trunc()
    });
    is("select(x, y, x < 0.0 && !(y > 3.0) || x == 7.25)", |x, y| {
        if x < 0.0 && y <= 3.0 || x == 7.25 { y } else { x }
    });
    is("sqrt(x) + inverseSqrt(y)", |x, y| x.sqrt() + (1.0 / f64::from(y).sqrt()) as f32);
    is("radians(x) + degrees(y)", |x, y| {
        x * (std::f32::consts::PI / 180.0) + y * (180.0 / std::f32::consts::PI)
    });
}

#[test]
fn integers_truths_and_vectors() {
    is("f32(i32(x) / 3 + i32(y) % 2 - (i32(x) >> 1u) + (i32(x) << 2u))", |x, y| {
        let (i, j) = (x as i32, y as i32);
        (i / 3 + j % 2 - (i >> 1) + (i << 2)) as f32
    });
    is("f32((u32(y) ^ 5u) & 6u | 8u) + f32(countOneBits(u32(y))) + f32(~i32(x))", |x, y| {
        let u = y as u32;
        ((u ^ 5) & 6 | 8) as f32 + u.count_ones() as f32 + !(x as i32) as f32
    });
    is("f32(min(i32(x), -3)) + f32(max(u32(y), 2u)) + f32(abs(i32(x))) + f32(x < y)", |x, y| {
        (x as i32).min(-3) as f32
            + (y as u32).max(2) as f32
            + (x as i32).abs() as f32
            + f32::from(u8::from(x < y))
    });
    is("dot(vec3(x, y, 2.0), vec3f(1.0, x, y).zyx) + (vec2(x, y) * 2.0).y", |x, y| {
        x * y + y * x + 2.0 * 1.0 + y * 2.0
    });
    is("length(vec2(x, y)) + distance(vec2(x), vec2(y, 1.0))", |x, y| {
        (x * x + y * y).sqrt() + ((x - y) * (x - y) + (x - 1.0) * (x - 1.0)).sqrt()
    });
    is("cross(vec3(x, y, 1.0), vec3(y, 2.0, x)).z", |x, y| x * 2.0 - y * y);
    is("select(0.0, 1.0, all(vec2(x, y) > vec2(1.0)) || any(vec2(x, y) == vec2(-20.0, 9.0)))", |x, y| {
        f32::from(u8::from((x > 1.0 && y > 1.0) || x == -20.0))
    });
    is("vec4(1.0, 2.0, 4.0, x)[i32(y) % 4] + bitcast<f32>(bitcast<u32>(x))", |x, y| {
        [1.0, 2.0, 4.0, x][y as usize % 4] + x
    });
    is("modf(x).fract + modf(y).whole", |x, y| (x - x.trunc()) + y.trunc());
}

#[test]
fn statements_go_all_ways_at_once() {
    is(
        "fn f(x: f32, y: f32) -> f32 {
            var r = x;
            if x < 0.0 { r = r * 2.0; if y > 3.0 { return -1.0; } r += 1.0; } else if x > 10.0 { r = y; }
            return r + 0.5;
        }",
        |x, y| match () {
            () if x < 0.0 && y > 3.0 => -1.0,
            () if x < 0.0 => x * 2.0 + 1.0 + 0.5,
            () if x > 10.0 => y + 0.5,
            () => x + 0.5,
        },
    );
    is(
        "fn f(x: f32, y: f32) -> f32 {
            var r = 1.0;
            switch i32(y) {
                case 0: { r = 10.0; }
                case 1, 2: { if x < 0.0 { break; } r = 20.0; }
                case 3: { return x; }
                default: { r = -x; }
            }
            r += 1.0;
            return r;
        }",
        |x, y| match y as i32 {
            0 => 11.0,
            1 | 2 if x < 0.0 => 2.0,
            1 | 2 => 21.0,
            3 => x,
            _ => -x + 1.0,
        },
    );
    is(
        "struct Pair { a: f32, b: vec2f }
        fn add(p: ptr<function, f32>, by: f32) { if by < 0.0 { return; } *p += by; }
        fn pair(x: f32) -> Pair { return Pair(x, vec2(x + 1.0, 3.0)); }
        fn f(x: f32, y: f32) -> f32 {
            var sum = y;
            add(&sum, x);
            var p = pair(sum);
            p.b.y = 4.0;
            p.b[0] += p.a;
            return p.b.x + p.b.y;
        }",
        |x, y| {
            let sum = if x < 0.0 { y } else { y + x };
            (sum + 1.0) + sum + 4.0
        },
    );
}

#[test]
fn loops_end_fragment_by_fragment() {
    is(
        "fn f(x: f32, y: f32) -> f32 {
            var sum = 0.0;
            for (var i = 0; i < i32(y); i++) {
                if i == 2 { continue; }
                if f32(i) > x { break; }
                sum += f32(i) + x;
            }
            return sum;
        }",
        |x, y| {
            let turns = (0..y as i32).take_while(|&i| i == 2 || i as f32 <= x).filter(|&i| i != 2);
            turns.fold(0.0, |sum, i| sum + (i as f32 + x))
        },
    );
    is(
        "fn f(x: f32, y: f32) -> f32 {
            var n = 0;
            var i = 0;
            while i < 5 {
                var j = 0;
                loop {
                    n += 1;
                    if f32(n) > y * 2.0 { return f32(100 + n); }
                    continuing { j += 1; break if j >= i || x < 0.0; }
                }
                switch i { case 3: { i += 2; continue; } default: {} }
                i += 1;
            }
            return f32(n);
        }",
        |x, y| {
            let (mut n, mut i) = (0, 0);
            while i < 5 {
                let mut j = 0;
                loop {
                    n += 1;
                    if n as f32 > y * 2.0 {
                        return (100 + n) as f32;
                    }
                    j += 1;
                    if j >= i || x < 0.0 {
                        break;
                    }
                }
                i += if i == 3 { 2 } else { 1 };
            }
            n as f32
        },
    );
    is(
        "fn g(n: i32) -> i32 { var k = 0; loop { if k * k >= n { return k; } k++; } return 0; }
        fn f(x: f32, y: f32) -> f32 { if x < 0.0 { return -1.0; } return f32(g(i32(x)) + g(i32(y))); }",
        |x, y| {
            let root = |n: f32| (n as i32 as f32).sqrt().ceil();
            if x < 0.0 { -1.0 } else { root(x) + root(y) }
        },
    );
}

#[test]
fn loops_without_end_have_no_result_and_hold_up_nobody() {
    let text = "fn f(x: f32, y: f32) -> f32 {
        var i = 0;
        while i < 10 || x < 0.0 { i++; }
        return f32(i);
    }";
    let places = places();
    for (&(x, _), got) in places.iter().zip(run(text, &[], &places)) {
        assert!(if x < 0.0 { got.is_nan() } else { got == 10.0 }, "{x}: {got}");
    }
    let turns = |n: u32| {
        run(
            &format!("fn f(x: f32) -> f32 {{ var i = 0u; while i < {n} {{ i++; }} return f32(i); }}"),
            &[],
            &[(0.0, 0.0)],
        )[0]
    };
    assert_eq!(turns(MAX_ITERATIONS - 1), (MAX_ITERATIONS - 1) as f32);
    assert!(turns(MAX_ITERATIONS + 1).is_nan());
}

#[test]
fn a_result_does_not_depend_on_its_neighbours() {
    let text = "fn f(x: f32, y: f32) -> f32 {
        var s = exp(x) + sin(y);
        for (var i = 0.0; i < y; i += 1.0) { s += pow(abs(x), i * 0.5) + log(y); }
        return s;
    }";
    let places = places();
    let together = run(text, &[], &places);
    for (i, &place) in places.iter().enumerate() {
        let alone = run(text, &[], &[place])[0];
        assert_eq!(alone.to_bits(), together[i].to_bits(), "{place:?}");
    }
}

#[test]
fn free_names_are_uniforms() {
    let source = parse("gain * exp(-k * x) + k");
    assert_eq!(source.uniforms(), ["gain", "k"]);
    assert!(source.reads("x") && !source.reads("y"));
    assert_eq!(run("gain * x + k", &[2.0, 0.5], &[(3.0, 0.0)]), [6.5]);
    let module = parse("fn f(s: f32, x: f32, k: f32) -> f32 { return s * k; }");
    assert_eq!(module.uniforms(), ["s", "k"]);
    assert!(!module.reads("x"));
    assert_eq!(run("pow(x, k)", &[3.0], &[(-2.0, 0.0)]), [-8.0]);
    assert_eq!(run("select(1.0, 2.0, k > 0.0)", &[-1.0], &[(3.0, 0.0)]), [1.0]);
}

#[test]
fn refusals_show_the_users_own_text() {
    let shown = refusal("1.0 +\n  x * )");
    assert!(shown.contains("f:2:7") && shown.contains("2 │   x * )") && shown.contains('^'), "{shown}");
    let shown = refusal("exp(x, y)");
    assert!(shown.contains("f:1:") && shown.contains("exp(x, y)") && !shown.contains("return"), "{shown}");
    let shown = refusal("x + vec2(1.0)");
    assert!(shown.contains("error") && !shown.contains("fn f"), "{shown}");
    let shown = refusal("(x + y");
    assert!(shown.contains("f:1:") && !shown.contains("fn f"), "{shown}");
    for (text, what) in [
        ("fn f(x: f32) -> i32 { return 1; }", "has to return f32"),
        ("fn f(x: f32) { }", "has to return f32"),
        ("fn f(x: i32) -> f32 { return f32(x); }", "`x` has to be f32"),
        ("fn g(x: f32) -> f32 { return x; }", "no `fn f(x: f32, y: f32) -> f32`"),
        ("@group(0) @binding(0) var t: texture_2d<f32>; fn f(x: f32) -> f32 { return x; }", "`t`"),
        ("var<private> p: f32; fn f(x: f32) -> f32 { return x + p; }", "`p`"),
        ("@compute @workgroup_size(1) fn main() {} fn f(x: f32) -> f32 { return x; }", "entry points"),
        ("override k: f32; fn f(x: f32) -> f32 { return x * k; }", "overrides"),
        ("fn f(x: f32) -> f32 { loop { } return x; }", "never ends"),
        ("fn f(x: f32) -> f32 { loop { if false { break; } } return x; }", "never ends"),
        ("fn f(x: f32) -> f32 { let m = mat2x2f(1.0, 0.0, 0.0, 1.0); return m[0].x; }", "matrices"),
        ("fn f(x: f32) -> f32 { var a = array<f32, 3>(); return a[0]; }", "arrays"),
        ("fn f(x: f32) -> f32 { return dpdx(x); }", "error"),
        ("x; y", "not part of an expression"),
        ("x) + (y", "nothing to close"),
        ("f16(x)", "error"),
        ("x + \u{1}", "control character"),
        ("frexp(x).fract", "not supported"),
    ] {
        let shown = refusal(text);
        assert!(shown.contains(what), "{text}: {shown}");
    }
    assert!(refusal(&"x + ".repeat(4000)).contains("at most 8192"));
}

#[test]
fn what_would_take_too_much_is_refused() {
    let mut chain = String::from("fn g0(x: f32) -> f32 { return x * 1.5 + x; }");
    for i in 1..40 {
        let g = i - 1;
        chain.extend([format!("fn g{i}(x: f32) -> f32 {{ return g{g}(x) * g{g}(x + 1.0); }}")]);
    }
    assert!(refusal(&format!("{chain} fn f(x: f32) -> f32 {{ return g39(x); }}")).contains("too long"));
    let mut structs = String::from("struct S0 { a: f32, b: f32 }");
    for i in 1..60 {
        let s = i - 1;
        structs.extend([format!("struct S{i} {{ a: S{s}, b: S{s} }}")]);
    }
    assert!(!refusal(&format!("{structs} fn f(x: f32) -> f32 {{ var s = S59(); return x; }}")).is_empty());
    let deep = format!("{}x{}", "(".repeat(3000), ")".repeat(3000));
    assert!(!refusal(&deep).is_empty());
    // long, but flat
    let sum = vec!["x"; 2000].join(" + ");
    assert_eq!(run(&sum, &[], &[(1.0, 0.0)]), [2000.0]);
}
