// Functions of the user's own may give what is none.

// fragments of which that is so
@group(0) @binding(4) var<storage, read_write> invalid_count: atomic<u32>;

// Once for a fragment, however many parts it is drawn in.
fn report_invalid() {
    if is_first_part {
        atomicAdd(&invalid_count, 1u);
    }
}
