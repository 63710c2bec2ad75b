// Sets of a pixel's samples. MASK_WORDS is a constant that the technique's form sets, as many words of 32 as there are bits.

alias Mask = array<u32, MASK_WORDS>;

// the mask that was drawn last
var<private> drawn: Mask;
// the samples that what has been shown covers
var<private> covered: Mask;

// MASK_WORDS, in a form that compilers do not unroll loops by: theirs over wide masks take minutes.
fn words_of(masking: Masking) -> u32 {
    return (masking.bits + 31u) / 32u;
}

// The bits of a word that belong to a mask.
fn lanes(word: u32, bits: u32) -> u32 {
    let first = 32u * word;
    if bits <= first {
        return 0u;
    }
    return select(0xffffffffu, (1u << (bits - first)) - 1u, bits - first < 32u);
}

// Blocks of the draws: one rounds the number of samples, positions follow.
const ROUNDING = 0u;
const POSITIONS = 1u;

// As many of the samples as alpha asks for, every choice as likely as another (Bentley & Floyd 1987); or all others.
fn draw_so_many(masking: Masking, draws: u32, alpha: f32) {
    let bits = masking.bits;
    let share = exactly(alpha, bits);
    let count = share.whole + select(0u, 1u, is_within_fraction(mixed(draws, ROUNDING), share));
    for (var last = bits - min(count, bits - count); last < bits; last++) {
        let candidate = below(last + 1u, mixed(draws, POSITIONS + last));
        let is_in = ((drawn[candidate / 32u] >> (candidate % 32u)) & 1u) != 0u;
        let sample = select(candidate, last, is_in);
        drawn[sample / 32u] |= 1u << (sample % 32u);
    }
    if count > bits - count {
        for (var w = 0u; w < words_of(masking); w++) {
            drawn[w] = ~drawn[w] & lanes(w, bits);
        }
    }
}

// Those of 32 random numbers that are less than alpha: binary digits are drawn from the front, for all of them at once, until
// each differs from alpha's. Two words share a block of two draws.
fn less_than_alpha(masking: Masking, draws: u32, alpha: f32, word: u32) -> u32 {
    var undecided = lanes(word, masking.bits);
    let threshold = exactly(alpha, 1u);
    if threshold.whole > 0u {
        return undecided;
    }
    var less = 0u;
    for (var digit = 31; digit >= 0 && undecided != 0u; digit--) {
        let block = POSITIONS + 2u * ((word / 2u) * 32u + u32(digit)) + (1u - word % 2u);
        let random = mixed(draws, block);
        if ((threshold.fraction >> u32(digit)) & 1u) != 0u {
            less |= undecided & ~random;
            undecided &= random;
        } else {
            undecided &= ~random;
        }
    }
    return less;
}

// The mask of a fragment.
fn draw_mask(masking: Masking, pixel: vec2u, primitive: u32, alpha: f32) {
    let draws = draws_of(pixel, primitive, masking.seed);
    if masking.stratified != 0u {
        drawn = Mask();
        draw_so_many(masking, draws, alpha);
        return;
    }
    for (var w = 0u; w < words_of(masking); w++) {
        drawn[w] = less_than_alpha(masking, draws, alpha, w);
    }
}

// How many samples of the mask that was drawn nothing covers.
fn count_visible() -> u32 {
    var count = 0u;
    for (var w = 0u; w < MASK_WORDS; w++) {
        count += countOneBits(drawn[w] & ~covered[w]);
    }
    return count;
}

// Covers them.
fn cover_drawn() {
    for (var w = 0u; w < MASK_WORDS; w++) {
        covered[w] |= drawn[w];
    }
}
