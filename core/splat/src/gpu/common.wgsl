// What all shaders of the rasteriser share: the frame's constants, limits of the method, and guards.
// Before this text stands `const G: u32 = …;`, the groups of four channels: features, depth if asked for, transmittance.
// Dispatches with more than ROW workgroups are rows of ROW; a kernel's own bound test leaves out what is too many.

struct Params {
    // Rows of camera-from-world: rotation and translation.
    rows: array<vec4f, 3>,
    // Focal lengths and principal point, pixels.
    lens: vec4f,
    // Bounds on x/z and y/z inside the Jacobian: low 2, high 2.
    bounds: vec4f,
    near: f32,
    low_pass: f32,
    count: u32,
    features: u32,
    // Features, and depth if asked for; the transmittance is channel number `channels`.
    channels: u32,
    width: u32,
    height: u32,
    columns: u32,
    tiles: u32,
    capacity: u32,
    // Blocks of a sort's table of counts.
    stride: u32,
    spare: u32,
}

// Words of the buffer of totals.
const ENTRIES: u32 = 0u;
const WANTED: u32 = 1u;
const GAUSSIANS: u32 = 2u;

const ROW: u32 = 32768u;
const TILE: u32 = 16u;
const ALPHA_MIN: f32 = 0.003921569;
const ALPHA_MAX: f32 = 0.99;
const TRANSMITTANCE_MIN: f32 = 1e-4;
const SLACK_PX: f32 = 2e-3;
const LOG2_E: f32 = 1.442695;
const NOWHERE: u32 = 0xffffffffu;

// By its bits: a compiler may take floats to be finite.
fn finite(x: f32) -> bool {
    return (bitcast<u32>(x) & 0x7f800000u) != 0x7f800000u;
}

fn finite3(v: vec3f) -> bool {
    return finite(v.x) && finite(v.y) && finite(v.z);
}

fn finite4(v: vec4f) -> bool {
    return finite3(v.xyz) && finite(v.w);
}

var<workgroup> scanned: array<u32, 256>;

// Sum of the values of the lanes before this one; `scanned[255]` is the sum of all. Ends with a barrier behind it.
fn scan(lane: u32, value: u32) -> u32 {
    scanned[lane] = value;
    workgroupBarrier();
    for (var step = 1u; step < 256u; step *= 2u) {
        var other = 0u;
        if lane >= step {
            other = scanned[lane - step];
        }
        workgroupBarrier();
        scanned[lane] += other;
        workgroupBarrier();
    }
    return scanned[lane] - value;
}
