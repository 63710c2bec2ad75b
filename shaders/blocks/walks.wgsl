// What streams of fragments share. A technique has `begin`, `take` and `finish`, and may have `again`, which a pixel is asked
// after its last fragment: whether it wants all of them once more.

// the walk over the fragments that is at hand; the first one is 0
var<private> walk: u32;
// set where nothing is wanted of the walk's other fragments
var<private> is_done: bool;

// Fragments come from the end of their order.
override backwards: bool = false;
