// What weights, and the depths that they see, are kept within.

const LEAST_WEIGHT = 1e-30;
const MOST_WEIGHT = 1e30;
const LEAST_DEPTH = 1e-4;
