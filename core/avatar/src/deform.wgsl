// Canonical Gaussians to one frame's world and the exact way back, a Gaussian a thread. Twin of deform.rs, whose comments
// say why. The entry points are in picture.wgsl.
//
// Parameters lie group after group in the order of `Group`, the rows of all Gaussians one after another in each.

struct Body {
    count: u32,
    // Motion coefficients.
    modes: u32,
    // Of a Gaussian: 3 without a light, 8 with one.
    features: u32,
    // Workgroups of the way back.
    blocks: u32,
    // Of the camera, world.
    centre: vec4f,
}

@group(0) @binding(0) var<uniform> body: Body;
@group(0) @binding(1) var<storage, read> parameters: array<f32>;
// Rows of the five joints' transforms, 60 floats; then the coefficients.
@group(0) @binding(2) var<storage, read> motion: array<f32>;

const JOINTS: u32 = 5u;
const JOINT_WORDS: u32 = 60u;
const WEIGHT_FLOOR: f32 = 1e-6;

// Where the groups begin, in Gaussians' rows of one float.
const POSITIONS: u32 = 0u;
const LOG_SCALES: u32 = 3u;
const ROTATIONS: u32 = 6u;
const OPACITIES: u32 = 10u;
const ALBEDOS: u32 = 11u;
const ROUGHNESS: u32 = 14u;
const REFLECTANCES: u32 = 15u;
const BASES: u32 = 16u;

fn three(group: u32, g: u32) -> vec3f {
    let at = group * body.count + 3u * g;
    return vec3f(parameters[at], parameters[at + 1u], parameters[at + 2u]);
}

fn basis_at(g: u32, mode: u32) -> u32 {
    return BASES * body.count + 3u * (g * body.modes + mode);
}

fn weight_at(g: u32, joint: u32) -> u32 {
    return (BASES + 3u * body.modes) * body.count + JOINTS * g + joint;
}

fn joint_row(joint: u32, row: u32) -> vec4f {
    let at = 12u * joint + 4u * row;
    return vec4f(motion[at], motion[at + 1u], motion[at + 2u], motion[at + 3u]);
}

struct Local {
    expressed: vec3f,
    // Clamped at 0 and normalised.
    weights: array<f32, 5>,
    weight_sum: f32,
    // Rows of the blended transform.
    m: array<vec4f, 3>,
}

fn local(g: u32) -> Local {
    var out: Local;
    out.expressed = three(POSITIONS, g);
    for (var mode = 0u; mode < body.modes; mode++) {
        let at = basis_at(g, mode);
        let basis = vec3f(parameters[at], parameters[at + 1u], parameters[at + 2u]);
        out.expressed += motion[JOINT_WORDS + mode] * basis;
    }
    var sum = 0.0;
    for (var j = 0u; j < JOINTS; j++) {
        out.weights[j] = max(parameters[weight_at(g, j)], 0.0);
        sum += out.weights[j];
    }
    out.weight_sum = max(sum, WEIGHT_FLOOR);
    for (var j = 0u; j < JOINTS; j++) {
        out.weights[j] /= out.weight_sum;
        for (var row = 0u; row < 3u; row++) {
            out.m[row] += out.weights[j] * joint_row(j, row);
        }
    }
    return out;
}

// One of the four rows (x, y, z, w largest) of the symmetric matrix 4qqᵀ, columns x, y, z, w.
struct Row {
    chosen: u32,
    value: vec4f,
}

fn quaternion_row(m: array<vec4f, 3>) -> Row {
    let a = m[0].x;
    let b = m[1].y;
    let c = m[2].z;
    var diagonal = array<f32, 4>(1.0 + a - b - c, 1.0 - a + b - c, 1.0 - a - b + c, 1.0 + a + b + c);
    var chosen = 3u;
    var most = diagonal[3];
    for (var i = 0u; i < 3u; i++) {
        if diagonal[i] > most {
            chosen = i;
            most = diagonal[i];
        }
    }
    let plus = vec3f(m[1].x + m[0].y, m[2].x + m[0].z, m[2].y + m[1].z);
    let minus = vec3f(m[2].y - m[1].z, m[0].z - m[2].x, m[1].x - m[0].y);
    var row = vec4f(minus, most);
    if chosen == 0u {
        row = vec4f(most, plus.x, plus.y, minus.x);
    } else if chosen == 1u {
        row = vec4f(plus.x, most, plus.z, minus.y);
    } else if chosen == 2u {
        row = vec4f(plus.y, plus.z, most, minus.z);
    }
    return Row(chosen, row);
}

// Gradient of the matrix (its last column is 0) from that of the chosen row.
fn quaternion_row_backward(chosen: u32, g: vec4f) -> array<vec4f, 3> {
    var signs = vec3f(1.0);
    var on_plus = vec3f(0.0);
    var on_minus = vec3f(0.0);
    var on_most = g.w;
    if chosen == 0u {
        signs = vec3f(1.0, -1.0, -1.0);
        on_plus = vec3f(g.y, g.z, 0.0);
        on_minus.x = g.w;
        on_most = g.x;
    } else if chosen == 1u {
        signs = vec3f(-1.0, 1.0, -1.0);
        on_plus = vec3f(g.x, 0.0, g.z);
        on_minus.y = g.w;
        on_most = g.y;
    } else if chosen == 2u {
        signs = vec3f(-1.0, -1.0, 1.0);
        on_plus = vec3f(0.0, g.x, g.y);
        on_minus.z = g.w;
        on_most = g.z;
    } else {
        on_minus = g.xyz;
    }
    let d = on_most * signs;
    return array<vec4f, 3>(
        vec4f(d.x, on_plus.x - on_minus.z, on_plus.y + on_minus.y, 0.0),
        vec4f(on_plus.x + on_minus.z, d.y, on_plus.z - on_minus.x, 0.0),
        vec4f(on_plus.y - on_minus.y, on_plus.z + on_minus.x, d.z, 0.0),
    );
}

// Quaternions are (w, x, y, z) in x, y, z, w of the vector.
fn hamilton(a: vec4f, b: vec4f) -> vec4f {
    return vec4f(
        a.x * b.x - a.y * b.y - a.z * b.z - a.w * b.w,
        a.x * b.y + a.y * b.x + a.z * b.w - a.w * b.z,
        a.x * b.z - a.y * b.w + a.z * b.x + a.w * b.y,
        a.x * b.w + a.y * b.z - a.z * b.y + a.w * b.x,
    );
}

fn conjugate(q: vec4f) -> vec4f {
    return vec4f(q.x, -q.yzw);
}

struct Unit {
    value: vec4f,
    length: f32,
}

fn normalised(q: vec4f) -> Unit {
    let size = sqrt(dot(q, q));
    if size > 1e-12 {
        return Unit(q / size, size);
    }
    return Unit(vec4f(1.0, 0.0, 0.0, 0.0), 1e-12);
}

fn normalised_backward(unit: Unit, g: vec4f) -> vec4f {
    return (g - dot(unit.value, g) * unit.value) / unit.length;
}

fn canonical_rotation(g: u32) -> Unit {
    let at = ROTATIONS * body.count + 4u * g;
    return normalised(vec4f(parameters[at], parameters[at + 1u], parameters[at + 2u], parameters[at + 3u]));
}

fn turn_of(row: Row) -> Unit {
    return normalised(row.value.wxyz);
}
