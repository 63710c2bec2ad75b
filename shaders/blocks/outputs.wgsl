// The attachments of a pass that is drawn in parts, from `first_output_of(placed)` on; what is beyond the last one goes nowhere.

struct Outputs {
    @location(0) at_0: vec4f,
    @location(1) at_1: vec4f,
    @location(2) at_2: vec4f,
    @location(3) at_3: vec4f,
    @location(4) at_4: vec4f,
    @location(5) at_5: vec4f,
    @location(6) at_6: vec4f,
    @location(7) at_7: vec4f,
}
