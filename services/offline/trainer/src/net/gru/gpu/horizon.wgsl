// Sizes of a dispatch of the kernels over the horizon.

struct Size {
    // Agents × draws.
    rows: u32,
    draws: u32,
    horizon: u32,
    // Whether the way back is kept.
    keep: u32,
}

@group(0) @binding(0) var<uniform> size: Size;
