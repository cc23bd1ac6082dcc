// What is kept coherent between neighbouring Gaussians, a Gaussian a thread: `draw`, then `settle`. Twin of coherent.rs.

struct Sheet {
    count: u32,
    // Factor on the shares.
    decay: f32,
    // Longer over shorter standard deviation at most, natural logarithm.
    elongation: f32,
    depth_share: f32,
    albedo_share: f32,
    facing: f32,
}

@group(0) @binding(0) var<uniform> sheet: Sheet;
// Group after group; see deform.wgsl.
@group(0) @binding(1) var<storage, read_write> parameters: array<f32>;
@group(0) @binding(2) var<storage, read> rest: array<f32>;
// Six a Gaussian; the largest number stands for none.
@group(0) @binding(3) var<storage, read> neighbours: array<u32>;
// Position and albedo logits of each.
@group(0) @binding(4) var<storage, read_write> drawn: array<f32>;
@group(0) @binding(5) var<storage, read> status: array<u32>;

const NEIGHBOURS: u32 = 6u;
const NONE: u32 = 0xffffffffu;
const LOG_SCALES: u32 = 3u;
const ROTATIONS: u32 = 6u;
const ALBEDOS: u32 = 11u;

fn three(group: u32, g: u32) -> vec3f {
    let at = group * sheet.count + 3u * g;
    return vec3f(parameters[at], parameters[at + 1u], parameters[at + 2u]);
}

fn set_three(group: u32, g: u32, value: vec3f) {
    let at = group * sheet.count + 3u * g;
    parameters[at] = value.x;
    parameters[at + 1u] = value.y;
    parameters[at + 2u] = value.z;
}

fn moved(g: u32) -> vec3f {
    return three(0u, g) - vec3f(rest[3u * g], rest[3u * g + 1u], rest[3u * g + 2u]);
}

fn normal_of(g: u32) -> vec3f {
    let at = ROTATIONS * sheet.count + 4u * g;
    let given = vec4f(parameters[at], parameters[at + 1u], parameters[at + 2u], parameters[at + 3u]);
    let q = given / max(sqrt(dot(given, given)), 1e-12);
    return vec3f(
        2.0 * (q.y * q.w + q.x * q.z),
        2.0 * (q.z * q.w - q.x * q.y),
        1.0 - 2.0 * (q.y * q.y + q.z * q.z),
    );
}

@compute @workgroup_size(64)
fn draw(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_index) lane: u32) {
    let g = (group.y * ROW + group.x) * 64u + lane;
    if g >= sheet.count || status[0] != 0u {
        return;
    }
    let normal = normal_of(g);
    var place = three(0u, g);
    var albedo = three(ALBEDOS, g);
    var along = 0.0;
    var mean = vec3f(0.0);
    var count = 0.0;
    for (var k = 0u; k < NEIGHBOURS; k++) {
        let other = neighbours[NEIGHBOURS * g + k];
        if other != NONE {
            along += dot(normal, moved(other));
            mean += three(ALBEDOS, other);
            count += 1.0;
        }
    }
    if count > 0.0 {
        place += sheet.decay * sheet.depth_share * (along / count - dot(normal, moved(g))) * normal;
        let share = sheet.decay * sheet.albedo_share * max(1.0 - max(normal.z, 0.0) / sheet.facing, 0.0);
        albedo += share * (mean / count - albedo);
    }
    for (var k = 0u; k < 3u; k++) {
        drawn[6u * g + k] = place[k];
        drawn[6u * g + 3u + k] = albedo[k];
    }
}

@compute @workgroup_size(64)
fn settle(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_index) lane: u32) {
    let g = (group.y * ROW + group.x) * 64u + lane;
    if g >= sheet.count || status[0] != 0u {
        return;
    }
    let at = 6u * g;
    set_three(0u, g, vec3f(drawn[at], drawn[at + 1u], drawn[at + 2u]));
    set_three(ALBEDOS, g, vec3f(drawn[at + 3u], drawn[at + 4u], drawn[at + 5u]));
    // Not thicker than wide, and no needle.
    let scales = three(LOG_SCALES, g);
    let least = min(scales.x, scales.y);
    let longest = least + sheet.elongation;
    set_three(LOG_SCALES, g, vec3f(min(scales.x, longest), min(scales.y, longest), min(scales.z, least)));
}
