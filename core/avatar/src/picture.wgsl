// The Gaussians of one frame as the rasteriser takes them, and from its gradients to those of the parameters and of the
// motion. Twin of picture.rs (activations, normals) around deform.wgsl, which stands before this text.
//
// Sums over Gaussians are made 64 by 64 in order and those added by a tree of fixed shape: the same bits every time.

// Three of four a Gaussian; see project.wgsl.
@group(0) @binding(3) var<storage, read_write> geometry: array<vec4f>;
@group(0) @binding(4) var<storage, read_write> features: array<f32>;
// Four of four a Gaussian, and as many as its features and one more need.
@group(0) @binding(5) var<storage, read> on_geometry: array<vec4f>;
@group(0) @binding(6) var<storage, read> on_features: array<vec4f>;
@group(0) @binding(7) var<storage, read_write> gradients: array<f32>;
// Of each workgroup, then of all: 60 by the joints' rows, then by the coefficients.
@group(0) @binding(8) var<storage, read_write> block_sums: array<f32>;
@group(0) @binding(9) var<storage, read_write> on_motion: array<f32>;

// What is added to the albedo of some Gaussians: how many and which, by how much in green, and of that in red and blue.
@group(0) @binding(10) var<storage, read> tinted: array<u32>;
@group(0) @binding(11) var<storage, read> green: array<f32>;
@group(0) @binding(12) var<storage, read> red_blue: array<vec2f>;

const ROUGHNESS_RANGE = vec2f(0.5, 0.5);
const REFLECTANCE_RANGE = vec2f(0.02, 0.13);

fn logistic(x: f32) -> f32 {
    let e = exp(-abs(x));
    return select(e, 1.0, x >= 0.0) / (1.0 + e);
}

fn third_axis(q: vec4f) -> vec3f {
    return vec3f(
        2.0 * (q.y * q.w + q.x * q.z),
        2.0 * (q.z * q.w - q.x * q.y),
        1.0 - 2.0 * (q.y * q.y + q.z * q.z),
    );
}

fn third_axis_backward(q: vec4f, g: vec3f) -> vec4f {
    return vec4f(
        2.0 * (q.z * g.x - q.y * g.y),
        2.0 * (q.w * g.x - q.x * g.y) - 4.0 * q.y * g.z,
        2.0 * (q.x * g.x + q.w * g.y) - 4.0 * q.z * g.z,
        2.0 * (q.y * g.x + q.z * g.y),
    );
}

fn place(own: Local) -> vec3f {
    let x = vec4f(own.expressed, 1.0);
    return vec3f(dot(own.m[0], x), dot(own.m[1], x), dot(own.m[2], x));
}

// −1 where the third axis points away from the camera.
fn facing(normal: vec3f, position: vec3f) -> f32 {
    return select(1.0, -1.0, dot(normal, body.centre.xyz - position) < 0.0);
}

@compute @workgroup_size(64)
fn pose_scene(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_index) lane: u32) {
    let g = (group.y * ROW + group.x) * 64u + lane;
    if g >= body.count {
        return;
    }
    let own = local(g);
    let position = place(own);
    let rotation = hamilton(turn_of(quaternion_row(own.m)).value, canonical_rotation(g).value);
    let opacity = logistic(parameters[OPACITIES * body.count + g]);
    geometry[3u * g] = vec4f(position, opacity);
    geometry[3u * g + 1u] = vec4f(exp(three(LOG_SCALES, g)), 0.0);
    geometry[3u * g + 2u] = rotation;
    let albedo = three(ALBEDOS, g);
    let at = body.features * g;
    for (var channel = 0u; channel < 3u; channel++) {
        features[at + channel] = logistic(albedo[channel]);
    }
    if body.features > 3u {
        let axis = third_axis(rotation);
        let normal = axis * facing(axis, position);
        for (var k = 0u; k < 3u; k++) {
            features[at + 3u + k] = normal[k];
        }
        let rough = logistic(parameters[ROUGHNESS * body.count + g]);
        let bright = logistic(parameters[REFLECTANCES * body.count + g]);
        features[at + 6u] = ROUGHNESS_RANGE.x + ROUGHNESS_RANGE.y * rough;
        features[at + 7u] = REFLECTANCE_RANGE.x + REFLECTANCE_RANGE.y * bright;
    }
}

// One of the tinted a thread; no Gaussian is among them twice.
@compute @workgroup_size(64)
fn tint(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_index) lane: u32) {
    let i = (group.y * ROW + group.x) * 64u + lane;
    if i >= tinted[0] || tinted[i + 1u] >= body.count {
        return;
    }
    let at = body.features * tinted[i + 1u];
    let share = red_blue[i];
    features[at] = clamp(features[at] + share.x * green[i], 0.0, 1.0);
    features[at + 1u] = clamp(features[at + 1u] + green[i], 0.0, 1.0);
    features[at + 2u] = clamp(features[at + 2u] + share.y * green[i], 0.0, 1.0);
}

fn give(group: u32, width: u32, g: u32, k: u32, value: f32) {
    gradients[group * body.count + width * g + k] = value;
}

// What a Gaussian gives to the motion.
struct ToMotion {
    on_expressed: vec3f,
    weights: array<f32, 5>,
    on_m: array<vec4f, 3>,
}

// Writes all gradients of a Gaussian but those by the motion.
fn pull_back_one(g: u32) -> ToMotion {
    var out: ToMotion;
    var own = local(g);
    out.weights = own.weights;
    let by_mean = on_geometry[4u * g];
    let by_scale = on_geometry[4u * g + 1u].xyz;
    var by_rotation = on_geometry[4u * g + 2u];
    let groups = body.features / 4u + 1u;
    let first = on_features[groups * g];
    let scales = exp(three(LOG_SCALES, g));
    let albedo = three(ALBEDOS, g);
    for (var k = 0u; k < 3u; k++) {
        give(LOG_SCALES, 3u, g, k, by_scale[k] * scales[k]);
        let unit = logistic(albedo[k]);
        give(ALBEDOS, 3u, g, k, first[k] * unit * (1.0 - unit));
    }
    let opacity = logistic(parameters[OPACITIES * body.count + g]);
    give(OPACITIES, 1u, g, 0u, by_mean.w * opacity * (1.0 - opacity));
    let unit = canonical_rotation(g);
    let row = quaternion_row(own.m);
    let turn = turn_of(row);
    var on_rough = 0.0;
    var on_bright = 0.0;
    if body.features > 3u {
        let second = on_features[groups * g + 1u];
        let rotation = hamilton(turn.value, unit.value);
        let on_axis = vec3f(first.w, second.xy) * facing(third_axis(rotation), place(own));
        by_rotation += third_axis_backward(rotation, on_axis);
        let rough = logistic(parameters[ROUGHNESS * body.count + g]);
        let bright = logistic(parameters[REFLECTANCES * body.count + g]);
        on_rough = second.z * ROUGHNESS_RANGE.y * rough * (1.0 - rough);
        on_bright = second.w * REFLECTANCE_RANGE.y * bright * (1.0 - bright);
    }
    give(ROUGHNESS, 1u, g, 0u, on_rough);
    give(REFLECTANCES, 1u, g, 0u, on_bright);
    // Position.
    let by = by_mean.xyz;
    out.on_expressed = own.m[0].xyz * by.x + own.m[1].xyz * by.y + own.m[2].xyz * by.z;
    for (var k = 0u; k < 3u; k++) {
        give(POSITIONS, 3u, g, k, out.on_expressed[k]);
    }
    for (var mode = 0u; mode < body.modes; mode++) {
        let coefficient = motion[JOINT_WORDS + mode];
        let at = basis_at(g, mode);
        for (var k = 0u; k < 3u; k++) {
            gradients[at + k] = coefficient * out.on_expressed[k];
        }
    }
    // Rotation.
    let on_canonical = normalised_backward(unit, hamilton(conjugate(turn.value), by_rotation));
    for (var k = 0u; k < 4u; k++) {
        give(ROTATIONS, 4u, g, k, on_canonical[k]);
    }
    let on_turn = normalised_backward(turn, hamilton(by_rotation, conjugate(unit.value)));
    let on_row = quaternion_row_backward(row.chosen, on_turn.yzwx);
    let x = vec4f(own.expressed, 1.0);
    for (var k = 0u; k < 3u; k++) {
        out.on_m[k] = by[k] * x + on_row[k];
    }
    // Blend.
    var along = array<f32, 5>();
    var mean = 0.0;
    for (var j = 0u; j < JOINTS; j++) {
        along[j] = dot(joint_row(j, 0u), out.on_m[0]) + dot(joint_row(j, 1u), out.on_m[1])
            + dot(joint_row(j, 2u), out.on_m[2]);
        mean += along[j] * own.weights[j];
    }
    for (var j = 0u; j < JOINTS; j++) {
        let at = weight_at(g, j);
        gradients[at] = select(0.0, (along[j] - mean) / own.weight_sum, parameters[at] > 0.0);
    }
    return out;
}

// 64 lanes by 60 values.
var<workgroup> shares: array<f32, 3840>;

@compute @workgroup_size(64)
fn pull_back(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_index) lane: u32) {
    let block = group.y * ROW + group.x;
    let g = block * 64u + lane;
    var own: ToMotion;
    if g < body.count {
        own = pull_back_one(g);
    }
    let all = JOINT_WORDS + body.modes;
    for (var first = 0u; first < all; first += 60u) {
        for (var k = 0u; k < 60u; k++) {
            var value = 0.0;
            if g < body.count {
                if first == 0u {
                    value = own.weights[k / 12u] * own.on_m[(k % 12u) / 4u][k % 4u];
                } else if first + k < all {
                    let at = basis_at(g, first + k - JOINT_WORDS);
                    let basis = vec3f(parameters[at], parameters[at + 1u], parameters[at + 2u]);
                    value = dot(basis, own.on_expressed);
                }
            }
            shares[60u * lane + k] = value;
        }
        workgroupBarrier();
        if lane < 60u && first + lane < all && block < body.blocks {
            var sum = 0.0;
            for (var other = 0u; other < 64u; other++) {
                sum += shares[60u * other + lane];
            }
            block_sums[block * all + first + lane] = sum;
        }
        workgroupBarrier();
    }
}

// One workgroup a value: its sum over the blocks.
@compute @workgroup_size(256)
fn sum_motion(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_index) lane: u32) {
    let all = JOINT_WORDS + body.modes;
    var sum = 0.0;
    for (var block = lane; block < body.blocks; block += 256u) {
        sum += block_sums[block * all + group.x];
    }
    shares[lane] = sum;
    workgroupBarrier();
    for (var half = 128u; half > 0u; half /= 2u) {
        if lane < half {
            shares[lane] += shares[lane + half];
        }
        workgroupBarrier();
    }
    if lane == 0u {
        on_motion[group.x] = shares[0];
    }
}
