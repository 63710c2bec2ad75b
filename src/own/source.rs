//! A function's text, parsed and validated.

use super::Signature;
use super::compile::compile;
use super::lexer::{Token, free_names, is_identifier, tokens};
use super::program::Program;
use super::report::Problem;
use super::shader;
use naga::valid::{Capabilities, ModuleInfo, ValidationFlags, Validator};
use naga::{Function, Handle, Module, Scalar, TypeInner};
use std::fmt;
use std::ops::Range;

/// Bytes of a text. The parser's stack grows with it.
pub const MAX_TEXT: usize = 8192;

/// Enough for the deepest expression that fits into a text.
const STACK: usize = 64 << 20;

/// A function in WGSL: a module with a function of a given name, or a bare expression.
pub struct Source {
    text: String,
    signature: &'static Signature,
    parsed: Parsed,
    uniforms: Vec<String>,
}

/// What naga made of the text.
struct Parsed {
    module: Module,
    info: ModuleInfo,
    entry: Handle<Function>,
    /// Where the user's text begins in what naga was given.
    offset: usize,
}

/// Two functions are the same if they have one text.
impl PartialEq for Source {
    fn eq(&self, other: &Self) -> bool {
        self.text == other.text && std::ptr::eq(self.signature, other.signature)
    }
}

impl fmt::Debug for Source {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:?}", self.text)
    }
}

impl Source {
    /// Reads a text.
    ///
    /// # Errors
    /// What is wrong with it, shown in the text.
    pub fn parse(text: &str, signature: &'static Signature) -> Result<Self, String> {
        let wrapped =
            Wrapped::new(text, signature).map_err(|problem| problem.show(signature.entry, text, 0))?;
        let parsed = on_a_large_stack(|| parse(&wrapped, signature));
        let parsed = parsed.map_err(|problem| problem.show(signature.entry, text, wrapped.offset))?;
        let arguments = &parsed.module.functions[parsed.entry].arguments;
        let names = arguments.iter().filter_map(|argument| argument.name.clone());
        let uniforms = names.filter(|name| !signature.arguments.contains(&name.as_str())).collect();
        Ok(Self { text: text.to_owned(), signature, parsed, uniforms })
    }

    /// Whether a text is a name rather than a function: a function that is one of its arguments is none.
    pub fn is_name(text: &str, signature: &Signature) -> bool {
        let text = text.trim();
        text.is_empty() || is_identifier(text) && !signature.arguments.contains(&text)
    }

    /// The text as it was given.
    pub fn text(&self) -> &str {
        &self.text
    }

    /// The scalars that have to be given a value, in their order.
    pub fn uniforms(&self) -> &[String] {
        &self.uniforms
    }

    /// Whether the function reads this argument.
    pub fn reads(&self, argument: &str) -> bool {
        let function = &self.parsed.module.functions[self.parsed.entry];
        let place = function.arguments.iter().position(|a| a.name.as_deref() == Some(argument));
        place.is_some_and(|place| {
            let argument = |expression: &naga::Expression| match *expression {
                naga::Expression::FunctionArgument(i) => i as usize == place,
                _ => false,
            };
            let info = &self.parsed.info[self.parsed.entry];
            function.expressions.iter().any(|(handle, e)| argument(e) && info[handle].ref_count > 0)
        })
    }

    /// The function as part of a shader, see [`shader::written`], and the names of its arguments in their order.
    ///
    /// # Panics
    /// On a bug in naga's writer.
    pub fn shader(&self, prefix: &str) -> (String, Vec<&str>) {
        let Parsed { module, entry, .. } = &self.parsed;
        let arguments = module.functions[*entry].arguments.iter();
        let names = arguments.map(|argument| argument.name.as_deref().unwrap_or("_")).collect();
        match shader::written(module, *entry, prefix) {
            Ok(text) => (text, names),
            Err(error) => panic!("{:?} cannot be written as a shader: {error}", self.text),
        }
    }

    /// The program, given the value of each uniform.
    ///
    /// # Errors
    /// What the program cannot be made to run, shown in the text.
    pub fn compile(&self, uniforms: &[f32]) -> Result<Program, String> {
        let Parsed { module, info, entry, offset } = &self.parsed;
        let values =
            self.uniforms.iter().map(String::as_str).zip(uniforms.iter().copied()).collect::<Vec<_>>();
        compile(module, info, *entry, self.signature.arguments, &values)
            .map_err(|problem| problem.show(self.signature.entry, &self.text, *offset))
    }
}

/// A module around the user's text.
struct Wrapped {
    module: String,
    offset: usize,
}

impl Wrapped {
    fn new(text: &str, signature: &Signature) -> Result<Self, Problem> {
        if text.len() > MAX_TEXT {
            return Err(Problem::new(format!(
                "the text has {} bytes, at most {MAX_TEXT} are allowed",
                text.len()
            )));
        }
        let odd = text.char_indices().find(|(_, c)| c.is_control() && !c.is_whitespace());
        if let Some((at, c)) = odd {
            return Err(Problem::labelled(
                "a control character",
                Some(at..at + c.len_utf8()),
                format!("{c:?}"),
            ));
        }
        let tokens = tokens(text);
        let found = |word: &str| tokens.iter().find(|(token, _)| *token == Token::Word(word));
        if let Some((_, place)) = found("array").or(found("binding_array")) {
            // whose sizes are numbers that a parser folds at any cost
            return Err(Problem::labelled("arrays are not supported", Some(place.clone()), "an array"));
        }
        if found("fn").is_some() {
            return Ok(Self { module: text.to_owned(), offset: 0 });
        }
        is_expression(&tokens)?;
        let names = free_names(&tokens, signature.arguments);
        let names = signature.arguments.iter().copied().chain(names);
        let parameters: Vec<_> = names.map(|name| format!("{name}: f32")).collect();
        let head = format!("fn {}({}) -> f32 {{ return (", signature.entry, parameters.join(", "));
        Ok(Self { offset: head.len(), module: format!("{head}{text}\n); }}") })
    }
}

/// One expression has no statements, and its brackets close.
fn is_expression(tokens: &[(Token<'_>, Range<usize>)]) -> Result<(), Problem> {
    let mut open = Vec::new();
    for (token, place) in tokens {
        let wrong = |label: &str| {
            let message = "expected an expression, or a module with a function";
            Err(Problem::labelled(message, Some(place.clone()), label))
        };
        match token {
            Token::Mark(mark @ ('(' | '[')) => open.push(if *mark == '(' { ')' } else { ']' }),
            Token::Mark(mark @ (')' | ']')) if open.pop() != Some(*mark) => {
                return wrong("nothing to close here");
            }
            Token::Mark(';' | '{' | '}' | '@') => return wrong("not part of an expression"),
            _ => {}
        }
    }
    Ok(())
}

/// Parses and validates, and finds the function.
fn parse(wrapped: &Wrapped, signature: &Signature) -> Result<Parsed, Problem> {
    let module = naga::front::wgsl::parse_str(&wrapped.module)?;
    let info =
        Validator::new(ValidationFlags::all(), Capabilities::SHADER_FLOAT16_IN_FLOAT32).validate(&module)?;
    let Signature { entry: name, arguments, .. } = signature;
    let found = module.functions.iter().find(|(_, function)| function.name.as_deref() == Some(name));
    let Some((entry, function)) = found else {
        return Err(Problem::new(format!(
            "there is no `fn {name}({}: f32) -> f32`",
            arguments.join(": f32, ")
        )));
    };
    let span = module.functions.get_span(entry);
    let is_f32 = |ty| module.types[ty].inner == TypeInner::Scalar(Scalar::F32);
    if !function.result.as_ref().is_some_and(|result| is_f32(result.ty)) {
        return Err(Problem::at(span, format!("`{name}` has to return f32")));
    }
    if let Some(wrong) = function.arguments.iter().find(|argument| !is_f32(argument.ty)) {
        let name = wrong.name.as_deref().unwrap_or("_");
        return Err(Problem::at(span, format!("`{name}` has to be f32, like all arguments and uniforms")));
    }
    if let Some((_, global)) = module.global_variables.iter().next() {
        let name = global.name.as_deref().unwrap_or("_");
        let span =
            module.global_variables.iter().next().map(|(handle, _)| module.global_variables.get_span(handle));
        let message =
            format!("`{name}`: variables, textures and buffers outside of functions are not supported");
        return Err(Problem::at(span.unwrap_or_default(), message));
    }
    if let Some((handle, _)) = module.overrides.iter().next() {
        let message = format!("overrides are not supported; a further f32 argument of `{name}` is a uniform");
        return Err(Problem::at(module.overrides.get_span(handle), message));
    }
    if let Some(entry) = module.entry_points.first() {
        return Err(Problem::new(format!("`{}`: entry points are not supported", entry.name)));
    }
    Ok(Parsed { offset: wrapped.offset, entry, info, module })
}

/// Runs a recursive parser where it has room, and survives its bugs.
fn on_a_large_stack<T: Send>(work: impl FnOnce() -> Result<T, Problem> + Send) -> Result<T, Problem> {
    std::thread::scope(|scope| {
        let thread = std::thread::Builder::new().stack_size(STACK).spawn_scoped(scope, work);
        let thread = thread.map_err(|error| Problem::new(format!("no thread for the parser: {error}")))?;
        thread.join().unwrap_or_else(|_| Err(Problem::new("the parser has failed, which is a bug in it")))
    })
}
