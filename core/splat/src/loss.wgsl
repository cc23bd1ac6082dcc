// The photometric loss and the matte's, and their gradient with respect to the encoded image, a pixel a lane. Twin of
// loss.rs and ssim.rs: mean absolute error, similarity by an 11×11 Gaussian window (σ = 1.5 px, zero padding), squared
// error of alpha. `across`, `similarity`, `back_across`, `differentiate`, `total` run in this order.

struct Weights {
    // Of a pixel's channel, mean taken; of a pixel's matte.
    l1: f32,
    dssim: f32,
    mask: f32,
    // Where the step is reported.
    slot: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<uniform> weights: Weights;
// Encoded RGB over black, and transmittance.
@group(0) @binding(2) var<storage, read> image: array<vec4f>;
// The same, and alpha.
@group(0) @binding(3) var<storage, read> wanted: array<vec4f>;
// Five maps smoothed along rows (a, b, a², b², ab), later three.
@group(0) @binding(4) var<storage, read_write> maps: array<vec4f>;
// By the mean of a (total), by E[a²], by E[ab]; the first map's fourth value is the pixel's similarity, summed.
@group(0) @binding(5) var<storage, read_write> slopes: array<vec4f>;
@group(0) @binding(6) var<storage, read_write> on_image: array<vec4f>;
// A tile's sums: absolute error, squared error (image held in [0, 1]), similarity, squared error of alpha.
@group(0) @binding(7) var<storage, read_write> sums: array<vec4f>;
// Two of four a step: the bits of the means of `sums`; entries wanted, and whether updates have stopped.
@group(0) @binding(8) var<storage, read_write> reports: array<vec4u>;
@group(0) @binding(9) var<storage, read> totals: array<u32>;
// Set by the first step whose entries had no room, for good: nothing that it or later steps would change is changed.
@group(0) @binding(10) var<storage, read_write> status: array<u32>;

const RADIUS: u32 = 5u;
const WINDOW = array<f32, 11>(
    0.00102838, 0.00759876, 0.03600077, 0.10936069, 0.21300554, 0.26601172, 0.21300554, 0.10936069, 0.03600077,
    0.00759876, 0.00102838,
);
const C1: f32 = 1e-4;
const C2: f32 = 9e-4;

fn pixels() -> u32 {
    return params.width * params.height;
}

fn is_inside(at: vec3u) -> bool {
    return at.x < params.width && at.y < params.height;
}

@compute @workgroup_size(16, 16)
fn across(@builtin(global_invocation_id) at: vec3u) {
    if !is_inside(at) {
        return;
    }
    var sum = array<vec3f, 5>();
    for (var k = 0u; k < 11u; k++) {
        let x = at.x + k;
        if x >= RADIUS && x < params.width + RADIUS {
            let index = at.y * params.width + x - RADIUS;
            let a = image[index].rgb;
            let b = wanted[index].rgb;
            sum[0] += WINDOW[k] * a;
            sum[1] += WINDOW[k] * b;
            sum[2] += WINDOW[k] * a * a;
            sum[3] += WINDOW[k] * b * b;
            sum[4] += WINDOW[k] * a * b;
        }
    }
    for (var map = 0u; map < 5u; map++) {
        maps[map * pixels() + at.y * params.width + at.x] = vec4f(sum[map], 0.0);
    }
}

// A map smoothed along the column.
fn down(map: u32, at: vec3u) -> vec3f {
    var sum = vec3f(0.0);
    for (var k = 0u; k < 11u; k++) {
        let y = at.y + k;
        if y >= RADIUS && y < params.height + RADIUS {
            sum += WINDOW[k] * maps[map * pixels() + (y - RADIUS) * params.width + at.x].rgb;
        }
    }
    return sum;
}

@compute @workgroup_size(16, 16)
fn similarity(@builtin(global_invocation_id) at: vec3u) {
    if !is_inside(at) {
        return;
    }
    let ma = down(0u, at);
    let mb = down(1u, at);
    let va = down(2u, at) - ma * ma;
    let vb = down(3u, at) - mb * mb;
    let cov = down(4u, at) - ma * mb;
    let l = 2.0 * ma * mb + C1;
    let k = 2.0 * cov + C2;
    let p = ma * ma + mb * mb + C1;
    let q = va + vb + C2;
    let scale = 1.0 / (p * q);
    let value = l * k * scale;
    // Chain through va = E[a²] − μa² and cov = E[ab] − μaμb.
    let by_cov = 2.0 * l * scale;
    let by_va = -value / q;
    let by_mean = 2.0 * (mb * k * scale - ma * value / p);
    let index = at.y * params.width + at.x;
    slopes[index] = vec4f(by_mean - 2.0 * ma * by_va - mb * by_cov, value.r + value.g + value.b);
    slopes[pixels() + index] = vec4f(by_va, 0.0);
    slopes[2u * pixels() + index] = vec4f(by_cov, 0.0);
}

@compute @workgroup_size(16, 16)
fn back_across(@builtin(global_invocation_id) at: vec3u) {
    if !is_inside(at) {
        return;
    }
    var sum = array<vec4f, 3>();
    for (var k = 0u; k < 11u; k++) {
        let x = at.x + k;
        if x >= RADIUS && x < params.width + RADIUS {
            for (var map = 0u; map < 3u; map++) {
                sum[map] += WINDOW[k] * slopes[map * pixels() + at.y * params.width + x - RADIUS];
            }
        }
    }
    for (var map = 0u; map < 3u; map++) {
        maps[map * pixels() + at.y * params.width + at.x] = sum[map];
    }
}

var<workgroup> shares: array<vec4f, 256>;

fn sum_of_lanes(lane: u32, value: vec4f) -> vec4f {
    shares[lane] = value;
    workgroupBarrier();
    for (var half = 128u; half > 0u; half /= 2u) {
        if lane < half {
            shares[lane] += shares[lane + half];
        }
        workgroupBarrier();
    }
    return shares[0];
}

@compute @workgroup_size(16, 16)
fn differentiate(@builtin(global_invocation_id) at: vec3u, @builtin(workgroup_id) tile: vec3u,
                 @builtin(local_invocation_index) lane: u32) {
    var own = vec4f(0.0);
    if is_inside(at) {
        let index = at.y * params.width + at.x;
        let a = image[index];
        let b = wanted[index];
        let off = a.rgb - b.rgb;
        let on_similarity = down(0u, at) + 2.0 * a.rgb * down(1u, at) + b.rgb * down(2u, at);
        let alpha_off = (1.0 - a.w) - b.w;
        let on_transmittance = -2.0 * weights.mask * alpha_off;
        on_image[index] = vec4f(weights.l1 * sign(off) - weights.dssim * on_similarity, on_transmittance);
        let held = clamp(a.rgb, vec3f(0.0), vec3f(1.0)) - b.rgb;
        let absolute = abs(off);
        own = vec4f(absolute.r + absolute.g + absolute.b, dot(held, held), slopes[index].w, alpha_off * alpha_off);
    }
    let sum = sum_of_lanes(lane, own);
    if lane == 0u {
        sums[tile.y * params.columns + tile.x] = sum;
    }
}

@compute @workgroup_size(256)
fn total(@builtin(local_invocation_index) lane: u32) {
    var own = vec4f(0.0);
    for (var tile = lane; tile < params.tiles; tile += 256u) {
        own += sums[tile];
    }
    let sum = sum_of_lanes(lane, own);
    if lane == 0u {
        if totals[WANTED] > params.capacity {
            status[0] = 1u;
        }
        reports[2u * weights.slot] = bitcast<vec4u>(sum / f32(pixels()));
        reports[2u * weights.slot + 1u] = vec4u(totals[WANTED], status[0], 0u, 0u);
    }
}
