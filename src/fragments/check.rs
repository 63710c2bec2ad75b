//! What a fragment list and a view must be, with errors that name the culprit.

use super::{Background, Lists};
use crate::error::{Error, Result};

/// The largest width and height, in pixels: twice what GPUs offer as a texture, and far inside the
/// rasteriser's guard band.
pub const MAX_SIZE: u32 = 32_768;

pub(crate) fn check_size(width: u32, height: u32) -> Result<()> {
    for (name, value) in [("width", width), ("height", height)] {
        if !(1..=MAX_SIZE).contains(&value) {
            return Err(Error::argument(name, format!("{value} is not in [1, {MAX_SIZE}]")));
        }
    }
    Ok(())
}

pub(crate) fn check_clip_planes(near: f64, far: f64) -> Result<()> {
    if !(near.is_finite() && near > 0.0) {
        return Err(Error::argument("near", format!("{near} is not a finite number > 0")));
    }
    if !(far.is_finite() && far > near) {
        return Err(Error::argument("far", format!("{far} is not a finite number > near = {near}")));
    }
    // depths are stored in single precision: nearer ones would lose digits, farther ones be infinite
    let (least, most) = (f64::from(f32::MIN_POSITIVE), f64::from(f32::MAX));
    if near < least {
        return Err(Error::argument("near", format!("{near:e} is not a number >= {least:e}")));
    }
    if far > most {
        return Err(Error::argument("far", format!("{far:e} is not a number <= {most:e}")));
    }
    Ok(())
}

pub(crate) fn check_color(argument: &'static str, color: [f32; 3]) -> Result<()> {
    if color.iter().all(|c| c.is_finite() && *c >= 0.0) {
        return Ok(());
    }
    let [r, g, b] = color;
    Err(Error::argument(argument, format!("({r}, {g}, {b}) has a channel that is not finite and >= 0")))
}

pub(super) fn check_offsets(lists: &Lists, pixels: usize) -> Result<()> {
    let offsets = &lists.offsets;
    let fault = |problem| Err(Error::argument("offsets", problem));
    if offsets.len() != pixels + 1 {
        return fault(format!(
            "has {} entries, width * height + 1 = {} are needed",
            offsets.len(),
            pixels + 1
        ));
    }
    if offsets[0] != 0 {
        return fault(format!("starts with {}, not with 0", offsets[0]));
    }
    if let Some(i) = (0..pixels).find(|&i| offsets[i + 1] < offsets[i]) {
        return fault(format!("falls from {} to {} at index {}", offsets[i], offsets[i + 1], i + 1));
    }
    let n = lists.depth.len();
    if usize::try_from(offsets[pixels]) != Ok(n) {
        return fault(format!("ends with {}, but depth has {n} entries", offsets[pixels]));
    }
    let lengths =
        [("color", lists.color.len()), ("alpha", lists.alpha.len()), ("primitive", lists.primitive.len())];
    for (name, length) in lengths {
        if length != n {
            return Err(Error::argument(name, format!("has {length} entries, but depth has {n}")));
        }
    }
    Ok(())
}

pub(super) fn check_values(lists: &Lists) -> Result<()> {
    let first = |bad: &dyn Fn(usize) -> bool| (0..lists.len()).find(|&i| bad(i));
    if let Some(i) = first(&|i| !(lists.depth[i].is_finite() && lists.depth[i] >= 0.0)) {
        let z = lists.depth[i];
        return Err(Error::argument("depth", format!("entry {i} is {z}, not a finite number >= 0")));
    }
    if let Some(i) = first(&|i| !(0.0..=1.0).contains(&lists.alpha[i])) {
        return Err(Error::argument("alpha", format!("entry {i} is {}, not in [0, 1]", lists.alpha[i])));
    }
    if let Some(i) = first(&|i| !lists.color[i].iter().all(|c| c.is_finite() && *c >= 0.0)) {
        let c = lists.color[i];
        return Err(Error::argument("color", format!("entry {i} is {c:?}, not three finite numbers >= 0")));
    }
    Ok(())
}

pub(super) fn check_background(background: &Background, width: u32, height: u32) -> Result<()> {
    match background {
        Background::Constant(color) => check_color("background", *color),
        Background::Image(colors) => {
            let pixels = width as usize * height as usize;
            if colors.len() != pixels {
                let problem = format!("has {} pixels, width * height = {pixels} are needed", colors.len());
                return Err(Error::argument("background", problem));
            }
            let bad = colors.iter().position(|c| !c.iter().all(|x| x.is_finite() && *x >= 0.0));
            bad.map_or(Ok(()), |i| {
                let (x, y) = (i % width as usize, i / width as usize);
                let problem =
                    format!("pixel (x={x}, y={y}) is {:?}, not three finite numbers >= 0", colors[i]);
                Err(Error::argument("background", problem))
            })
        }
    }
}

pub(super) fn check_primitive_depth(depths: &[f64], primitives: &[u32]) -> Result<()> {
    if let Some(i) = depths.iter().position(|z| !z.is_finite()) {
        return Err(Error::argument("primitive_depth", format!("entry {i} is {}, not finite", depths[i])));
    }
    match primitives.iter().position(|p| *p as usize >= depths.len()) {
        None => Ok(()),
        Some(i) => Err(Error::argument(
            "primitive",
            format!("entry {i} is {}, but primitive_depth has {} entries", primitives[i], depths.len()),
        )),
    }
}

pub(super) fn check_depth_range(range: Option<(f64, f64)>) -> Result<()> {
    match range {
        Some((lo, hi)) if !(lo.is_finite() && hi.is_finite() && 0.0 <= lo && lo <= hi) => {
            let problem = format!("({lo}, {hi}) is not a finite pair with 0 <= z_lo <= z_hi");
            Err(Error::argument("depth_range", problem))
        }
        _ => Ok(()),
    }
}
