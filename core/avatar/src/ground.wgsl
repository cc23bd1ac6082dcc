// What holds doubtful Gaussians to the ground they were laid out as, a Gaussian a thread: `draw`, then `settle`. Twin of
// ground.rs.

struct Ground {
    count: u32,
    // Motion coefficients.
    modes: u32,
    // Factor on the shares.
    decay: f32,
    own_color: f32,
    color_doubt: f32,
    position_share: f32,
    scale_share: f32,
    opacity_share: f32,
    other_share: f32,
}

@group(0) @binding(0) var<uniform> ground: Ground;
// Group after group; see deform.wgsl.
@group(0) @binding(1) var<storage, read_write> parameters: array<f32>;
// As laid out, in the same order.
@group(0) @binding(2) var<storage, read> rest: array<f32>;
// Six a Gaussian; the largest number stands for none.
@group(0) @binding(3) var<storage, read> neighbours: array<u32>;
// Position, albedo logits, roughness and reflectance logits of each.
@group(0) @binding(4) var<storage, read_write> drawn: array<f32>;
@group(0) @binding(5) var<storage, read> status: array<u32>;
// Doubt and kind of each.
@group(0) @binding(6) var<storage, read> doubts: array<f32>;

const NEIGHBOURS: u32 = 6u;
const NONE: u32 = 0xffffffffu;
const DRAWN: u32 = 8u;
const LOG_SCALES: u32 = 3u;
const ROTATIONS: u32 = 6u;
const OPACITIES: u32 = 10u;
const ALBEDOS: u32 = 11u;
const ROUGHNESS: u32 = 14u;
const REFLECTANCES: u32 = 15u;
const BASES: u32 = 16u;

fn place_of(g: u32) -> vec3f {
    return vec3f(parameters[3u * g], parameters[3u * g + 1u], parameters[3u * g + 2u]);
}

fn home_of(g: u32) -> vec3f {
    return vec3f(rest[3u * g], rest[3u * g + 1u], rest[3u * g + 2u]);
}

fn rest_normal(g: u32) -> vec3f {
    let at = ROTATIONS * ground.count + 4u * g;
    let given = vec4f(rest[at], rest[at + 1u], rest[at + 2u], rest[at + 3u]);
    let q = given / max(sqrt(dot(given, given)), 1e-12);
    return vec3f(
        2.0 * (q.y * q.w + q.x * q.z),
        2.0 * (q.z * q.w - q.x * q.y),
        1.0 - 2.0 * (q.y * q.y + q.z * q.z),
    );
}

// Number `k` of what is spread: albedo 0 to 2, roughness 3, reflectance 4.
fn color_at(g: u32, k: u32) -> u32 {
    if k < 3u {
        return ALBEDOS * ground.count + 3u * g + k;
    }
    return select(REFLECTANCES, ROUGHNESS, k == 3u) * ground.count + g;
}

@compute @workgroup_size(64)
fn draw(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_index) lane: u32) {
    let g = (group.y * ROW + group.x) * 64u + lane;
    if g >= ground.count || status[0] != 0u {
        return;
    }
    let doubt = doubts[2u * g];
    let kind = doubts[2u * g + 1u];
    var height = 0.0;
    var count = 0.0;
    var sums: array<f32, 5>;
    var equals = 0.0;
    for (var n = 0u; n < NEIGHBOURS; n++) {
        let other = neighbours[NEIGHBOURS * g + n];
        if other == NONE {
            continue;
        }
        height += dot(rest_normal(other), place_of(other) - home_of(other));
        count += 1.0;
        if doubts[2u * other + 1u] == kind {
            equals += 1.0;
            for (var k = 0u; k < 5u; k++) {
                sums[k] += parameters[color_at(other, k)];
            }
        }
    }
    height /= max(count, 1.0);
    let here = place_of(g);
    let moved = here + ground.position_share * ground.decay * doubt * (home_of(g) + height * rest_normal(g) - here);
    for (var k = 0u; k < 3u; k++) {
        drawn[DRAWN * g + k] = moved[k];
    }
    let weight = ground.own_color / max(doubt, 1e-6) * exp(-doubt / ground.color_doubt);
    for (var k = 0u; k < 5u; k++) {
        let own = parameters[color_at(g, k)];
        let mean = (weight * own + sums[k]) / max(weight + equals, 1e-12);
        drawn[DRAWN * g + 3u + k] = own + ground.decay * doubt * (mean - own);
    }
}

fn hold(at: u32, share: f32) {
    parameters[at] += share * (rest[at] - parameters[at]);
}

@compute @workgroup_size(64)
fn settle(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_index) lane: u32) {
    let g = (group.y * ROW + group.x) * 64u + lane;
    if g >= ground.count || status[0] != 0u || doubts[2u * g] == 0.0 {
        return;
    }
    for (var k = 0u; k < 3u; k++) {
        parameters[3u * g + k] = drawn[DRAWN * g + k];
    }
    for (var k = 0u; k < 5u; k++) {
        parameters[color_at(g, k)] = drawn[DRAWN * g + 3u + k];
    }
    let share = ground.decay * doubts[2u * g];
    for (var k = 0u; k < 3u; k++) {
        hold(LOG_SCALES * ground.count + 3u * g + k, share * ground.scale_share);
    }
    hold(OPACITIES * ground.count + g, share * ground.opacity_share);
    for (var k = 0u; k < 4u; k++) {
        hold(ROTATIONS * ground.count + 4u * g + k, share * ground.other_share);
    }
    let row = 3u * ground.modes;
    for (var k = 0u; k < row; k++) {
        hold(BASES * ground.count + row * g + k, share * ground.other_share);
    }
    let weights = (BASES + row) * ground.count;
    for (var k = 0u; k < 5u; k++) {
        hold(weights + 5u * g + k, share * ground.other_share);
    }
}
