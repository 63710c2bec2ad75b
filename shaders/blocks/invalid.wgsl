// Functions of the user's own may give what is none: fragments of which that is so are counted, once for all the parts that they
// are drawn in.
fn report_invalid() {
    if is_first_part {
        atomicAdd(&counters[INVALID], 1u);
    }
}
