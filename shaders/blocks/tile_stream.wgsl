// A tile's fragments as a stream in the order in which they are drawn.

fn meet(fragment: Fragment) {
    take(fragment);
}

// At the end of a walk over the tile: whether the pixel wants another.
fn wants_more() -> bool {
    is_done = false;
    let wants = again();
    walk++;
    return wants;
}
