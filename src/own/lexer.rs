//! As much of WGSL's lexical grammar as it takes to tell a bare expression from a module, and to find the names in
//! it that mean nothing to WGSL.

use std::ops::Range;

/// A word, a number or a mark of the text.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Token<'t> {
    /// An identifier or a keyword.
    Word(&'t str),
    /// A literal.
    Number,
    /// Any other character.
    Mark(char),
}

/// All tokens with their places; comments and blanks are left out.
pub fn tokens(text: &str) -> Vec<(Token<'_>, Range<usize>)> {
    let mut found = Vec::new();
    let mut at = 0;
    while let Some(first) = text[at..].chars().next() {
        let rest = &text[at..];
        let len = match first {
            _ if first.is_whitespace() => first.len_utf8(),
            _ if rest.starts_with("//") => rest.find('\n').unwrap_or(rest.len()),
            _ if rest.starts_with("/*") => comment(rest),
            _ if is_word_start(first) => {
                let len = rest.find(|c| !is_word(c)).unwrap_or(rest.len());
                found.push((Token::Word(&rest[..len]), at..at + len));
                len
            }
            _ if first.is_ascii_digit() || (first == '.' && starts_with_digit(&rest[1..])) => {
                let len = number(rest);
                found.push((Token::Number, at..at + len));
                len
            }
            mark => {
                found.push((Token::Mark(mark), at..at + mark.len_utf8()));
                mark.len_utf8()
            }
        };
        at += len;
    }
    found
}

fn is_word_start(c: char) -> bool {
    c == '_' || c.is_alphabetic()
}

fn is_word(c: char) -> bool {
    c == '_' || c.is_alphanumeric()
}

fn starts_with_digit(text: &str) -> bool {
    text.starts_with(|c: char| c.is_ascii_digit())
}

/// The length of a comment that may hold others.
fn comment(text: &str) -> usize {
    let (mut depth, mut at) = (0_usize, 0);
    while at < text.len() {
        let rest = &text.as_bytes()[at..];
        if rest.starts_with(b"/*") {
            (depth, at) = (depth + 1, at + 2);
        } else if rest.starts_with(b"*/") {
            (depth, at) = (depth - 1, at + 2);
            if depth == 0 {
                return at;
            }
        } else {
            at += 1;
        }
    }
    text.len()
}

/// The length of a number: digits, letters, dots, and a sign after an exponent's letter.
fn number(text: &str) -> usize {
    let is_hex = text.starts_with("0x") || text.starts_with("0X");
    let exponents = if is_hex { ['p', 'P'] } else { ['e', 'E'] };
    let mut before = ' ';
    for (at, c) in text.char_indices() {
        let sign = matches!(c, '+' | '-') && exponents.contains(&before);
        if !(sign || c == '.' || c.is_ascii_alphanumeric()) {
            return at;
        }
        before = c;
    }
    text.len()
}

/// Whether the text is one identifier.
pub fn is_identifier(text: &str) -> bool {
    text.starts_with(is_word_start) && text.chars().all(is_word)
}

/// Words that name types or truths rather than values of one's own.
const PREDECLARED: [&str; 31] = [
    "true", "false", "bitcast", "bool", "f32", "f16", "i32", "u32", "vec2", "vec3", "vec4", "vec2f", "vec3f",
    "vec4f", "vec2i", "vec3i", "vec4i", "vec2u", "vec3u", "vec4u", "vec2h", "vec3h", "vec4h", "mat2x2",
    "mat3x3", "mat4x4", "mat2x2f", "mat3x3f", "mat4x4f", "atomic", "ptr",
];

/// The names in a bare expression that are neither its arguments nor WGSL's, each once, in their order.
pub fn free_names<'t>(tokens: &[(Token<'t>, Range<usize>)], arguments: &[&str]) -> Vec<&'t str> {
    let mut names = Vec::new();
    for (i, (token, _)) in tokens.iter().enumerate() {
        let Token::Word(name) = *token else { continue };
        let is_member = i > 0 && tokens[i - 1].0 == Token::Mark('.');
        let is_called = matches!(tokens.get(i + 1), Some((Token::Mark('('), _)));
        let is_known = arguments.contains(&name) || PREDECLARED.contains(&name) || names.contains(&name);
        if !(is_member || is_called || is_known) {
            names.push(name);
        }
    }
    names
}

#[cfg(test)]
mod tests {
    use super::*;

    fn free(text: &str) -> Vec<&str> {
        free_names(&tokens(text), &["z", "a", "d"])
    }

    #[test]
    fn names_are_told_from_what_wgsl_knows() {
        assert_eq!(free("a * exp(-k * z) + k"), ["k"]);
        assert_eq!(free("vec2(z, s).xy.x * 1e-5f + .5e+3h - 0x1p-3f"), ["s"]);
        assert_eq!(free("select(z, gain /* not this */, z < near) // nor that"), ["gain", "near"]);
        assert_eq!(free("/* /* nested */ k */ μ_1 + z"), ["μ_1"]);
        assert_eq!(free("f32(true) + /* open"), Vec::<&str>::new());
    }

    #[test]
    fn every_character_has_its_place() {
        let text = "z ≤ a";
        let places: Vec<_> = tokens(text).into_iter().map(|(_, place)| &text[place]).collect();
        assert_eq!(places, ["z", "≤", "a"]);
        assert!(is_identifier("mb7") && !is_identifier("7") && !is_identifier("a b") && !is_identifier(""));
    }
}
