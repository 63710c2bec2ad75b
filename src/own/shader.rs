//! A function as part of a shader: its module under names that meet no others, its loops with an end.

use super::{MAX_ITERATIONS, Source};
use naga::back::wgsl::{WriterFlags, write_string};
use naga::valid::{Capabilities, ValidationFlags, Validator};
use naga::{
    AddressSpace, BinaryOperator, Block, Expression, Function, GlobalVariable, Handle, Literal,
    MemoryDecorations, Module, Range, Scalar, Span, Statement, Type, TypeInner,
};

/// The variable that counts the turns of all loops of an invocation, behind the module's prefix; beyond [`MAX_ITERATIONS`] all
/// are left.
const TURNS: &str = "turns";

/// The module as WGSL. Its names are none that the shader has: all begin with `prefix`, which that of `entry` follows as it is;
/// and every loop counts its turns.
///
/// # Errors
/// What naga says, which is a bug in it or here: the module was valid.
pub fn written(module: &Module, entry: Handle<Function>, prefix: &str) -> Result<String, String> {
    let mut module = module.clone();
    rename(&mut module, entry, prefix);
    let turns = count_turns(&mut module, prefix);
    let mut functions = std::mem::take(&mut module.functions);
    for (_, function) in functions.iter_mut() {
        end_loops(function, turns);
    }
    module.functions = functions;
    let info = Validator::new(ValidationFlags::all(), Capabilities::SHADER_FLOAT16_IN_FLOAT32)
        .validate(&module)
        .map_err(|error| error.to_string())?;
    write_string(&module, &info, WriterFlags::empty()).map_err(|error| error.to_string())
}

/// A function in a shader.
#[derive(Debug, Clone, Copy)]
pub struct Call<'a> {
    /// What all of its names begin with.
    pub prefix: &'a str,
    /// Its own name.
    pub entry: &'a str,
    /// What the shader gives, as WGSL declares it: arguments go by their names.
    pub parameters: &'a str,
    /// The array of `vec4f` that holds the uniforms.
    pub uniforms: &'a str,
}

/// Vectors of four that hold so many uniforms. No array is empty.
pub fn vectors(uniforms: usize) -> usize {
    uniforms.div_ceil(4).max(1)
}

/// The function, with `value`, which calls it with its uniforms, `is_lost` and the constant `UNIFORMS`, each behind the prefix.
pub fn callable(source: &Source, call: Call<'_>) -> String {
    let Call { prefix, entry, parameters, uniforms: array } = call;
    let (module, names) = source.shader(prefix);
    let uniforms = source.uniforms();
    let argument = |name: &&str| match uniforms.iter().position(|uniform| uniform == name) {
        Some(i) => format!("{array}[{}][{}]", i / 4, i % 4),
        None => (*name).to_owned(),
    };
    let arguments = names.iter().map(argument).collect::<Vec<_>>().join(", ");
    let vectors = vectors(uniforms.len());
    format!(
        "{module}
const {prefix}UNIFORMS = {vectors}u;
fn {prefix}value({parameters}) -> f32 {{
    {prefix}{TURNS} = 0u;
    return {prefix}{entry}({arguments});
}}
fn {prefix}is_lost() -> bool {{
    return {prefix}{TURNS} >= {MAX_ITERATIONS}u;
}}
"
    )
}

/// Names by numbers, whatever the user's are: naga changes names that others have taken before.
fn rename(module: &mut Module, entry: Handle<Function>, prefix: &str) {
    let prefixed = |name: &mut Option<String>, kind: &str, i: usize| {
        *name = Some(format!("{prefix}{kind}_{i}_"));
    };
    for (i, (handle, function)) in module.functions.iter_mut().enumerate() {
        if handle == entry {
            function.name = Some(format!("{prefix}{}", function.name.as_deref().unwrap_or_default()));
        } else {
            prefixed(&mut function.name, "function", i);
        }
        function.named_expressions.clear();
        for (i, argument) in function.arguments.iter_mut().enumerate() {
            prefixed(&mut argument.name, "argument", i);
        }
        for (i, (_, local)) in function.local_variables.iter_mut().enumerate() {
            prefixed(&mut local.name, "local", i);
        }
    }
    for (i, (_, constant)) in module.constants.iter_mut().enumerate() {
        prefixed(&mut constant.name, "constant", i);
    }
    let structs: Vec<_> = module
        .types
        .iter()
        .filter(|(_, ty)| matches!(ty.inner, TypeInner::Struct { .. }))
        .map(|(handle, ty)| (handle, ty.clone()))
        .collect();
    for (i, (handle, mut ty)) in structs.into_iter().enumerate() {
        prefixed(&mut ty.name, "type", i);
        module.types.replace(handle, ty);
    }
}

fn count_turns(module: &mut Module, prefix: &str) -> Handle<GlobalVariable> {
    let word = Type { name: None, inner: TypeInner::Scalar(Scalar::U32) };
    let ty = module.types.insert(word, Span::UNDEFINED);
    let variable = GlobalVariable {
        name: Some(format!("{prefix}{TURNS}")),
        space: AddressSpace::Private,
        binding: None,
        ty,
        init: None,
        memory_decorations: MemoryDecorations::empty(),
    };
    module.global_variables.append(variable, Span::UNDEFINED)
}

fn end_loops(function: &mut Function, turns: Handle<GlobalVariable>) {
    let mut body = std::mem::take(&mut function.body);
    end_loops_in(&mut body, function, turns);
    function.body = body;
}

fn end_loops_in(block: &mut Block, function: &mut Function, turns: Handle<GlobalVariable>) {
    for statement in block.iter_mut() {
        match statement {
            Statement::Block(block) => end_loops_in(block, function, turns),
            Statement::If { accept, reject, .. } => {
                end_loops_in(accept, function, turns);
                end_loops_in(reject, function, turns);
            }
            Statement::Switch { cases, .. } => {
                cases.iter_mut().for_each(|case| end_loops_in(&mut case.body, function, turns));
            }
            Statement::Loop { body, continuing, .. } => {
                end_loops_in(body, function, turns);
                end_loops_in(continuing, function, turns);
                leave_when_lost(body, function, turns);
                count_turn(continuing, function, turns);
            }
            _ => {}
        }
    }
}

/// `if turns >= MAX_ITERATIONS { break; }` before everything else.
fn leave_when_lost(body: &mut Block, function: &mut Function, turns: Handle<GlobalVariable>) {
    let mut add = |expression| function.expressions.append(expression, Span::UNDEFINED);
    let pointer = add(Expression::GlobalVariable(turns));
    let right = add(Expression::Literal(Literal::U32(MAX_ITERATIONS)));
    let left = add(Expression::Load { pointer });
    let condition = add(Expression::Binary { op: BinaryOperator::GreaterEqual, left, right });
    let leave = Block::from_vec(vec![Statement::Break]);
    let mut statements = Block::from_vec(vec![
        Statement::Emit(Range::new_from_bounds(left, condition)),
        Statement::If { condition, accept: leave, reject: Block::new() },
    ]);
    statements.append(body);
    *body = statements;
}

/// `turns += 1;` before another turn.
fn count_turn(continuing: &mut Block, function: &mut Function, turns: Handle<GlobalVariable>) {
    let mut add = |expression| function.expressions.append(expression, Span::UNDEFINED);
    let pointer = add(Expression::GlobalVariable(turns));
    let right = add(Expression::Literal(Literal::U32(1)));
    let left = add(Expression::Load { pointer });
    let value = add(Expression::Binary { op: BinaryOperator::Add, left, right });
    let mut statements = Block::from_vec(vec![
        Statement::Emit(Range::new_from_bounds(left, value)),
        Statement::Store { pointer, value },
    ]);
    statements.append(continuing);
    *continuing = statements;
}
