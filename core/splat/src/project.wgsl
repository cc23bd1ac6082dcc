// EWA projection and its derivative, one Gaussian a thread. Twin of project.rs, whose comments say why; the gather of
// an entry's slots is render.rs' `gather`: a Gaussian's slots lie together in the order of its tiles, so that their sum
// is the same on every run.

@group(0) @binding(0) var<uniform> params: Params;
// Three of four for a Gaussian: mean and opacity, scales, rotation (w, x, y, z).
@group(0) @binding(1) var<storage, read> geometry: array<vec4f>;
@group(0) @binding(2) var<storage, read> features: array<f32>;
// Two of four: mean 2, variance, shear; steepness, log2 opacity, reach, falloff.
@group(0) @binding(3) var<storage, read_write> records: array<vec4f>;
// G of four: features, depth if asked for, zeros.
@group(0) @binding(4) var<storage, read_write> payload: array<vec4f>;
@group(0) @binding(5) var<storage, read_write> keys: array<u32>;
@group(0) @binding(6) var<storage, read_write> order: array<u32>;
@group(0) @binding(7) var<storage, read_write> totals: array<u32>;
@group(0) @binding(8) var<storage, read> slots: array<vec4f>;
// First slot and number of slots of a Gaussian.
@group(0) @binding(9) var<storage, read> spans: array<vec2u>;
// Four of four: mean 3 and opacity; scales 3 and weight; rotation; mean in pixels 2 and radius.
@group(0) @binding(10) var<storage, read_write> on_geometry: array<vec4f>;
@group(0) @binding(11) var<storage, read_write> on_features: array<vec4f>;

const QUATERNION_MIN: f32 = 1e-12;

struct Factors {
    in_camera: vec3f,
    inverse_z: f32,
    // (w, x, y, z), and one over the given norm (0 where it counts as the identity).
    unit: vec4f,
    inverse_norm: f32,
    axes: array<vec3f, 3>,
    t: array<vec3f, 2>,
    a: array<vec3f, 2>,
    free: vec2f,
    slope: vec2f,
}

fn factors(mean: vec3f, scale: vec3f, rotation: vec4f) -> Factors {
    var f: Factors;
    for (var r = 0u; r < 3u; r++) {
        f.in_camera[r] = dot(mean, params.rows[r].xyz) + params.rows[r].w;
    }
    f.inverse_z = 1.0 / f.in_camera.z;
    let size = abs(rotation);
    let largest = max(max(size.x, size.y), max(size.z, size.w));
    let usable = largest > QUATERNION_MIN;
    // Twice scaled, so that neither step leaves the range of normal numbers.
    let first = select(1.0, 1e-20, largest > 1e20);
    let by_largest = 1.0 / max(largest * first, QUATERNION_MIN);
    let q = rotation * first * by_largest;
    let inverse = inverseSqrt(max(dot(q, q), 0.5));
    f.unit = select(vec4f(1.0, 0.0, 0.0, 0.0), q * inverse, usable);
    f.inverse_norm = select(0.0, by_largest * inverse * first, usable);
    let w = f.unit.x;
    let x = f.unit.y;
    let y = f.unit.z;
    let z = f.unit.w;
    f.axes[0] = vec3f(1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y));
    f.axes[1] = vec3f(2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + w * x));
    f.axes[2] = vec3f(2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y));
    f.free = f.in_camera.xy * f.inverse_z;
    f.slope = clamp(f.free, params.bounds.xy, params.bounds.zw);
    for (var k = 0u; k < 2u; k++) {
        f.t[k] = f.inverse_z * params.lens[k] * (params.rows[k].xyz - f.slope[k] * params.rows[2].xyz);
        f.a[k] = scale * vec3f(dot(f.axes[0], f.t[k]), dot(f.axes[1], f.t[k]), dot(f.axes[2], f.t[k]));
    }
    return f;
}

fn write_payload(g: u32, depth: f32) {
    for (var k = 0u; k < G; k++) {
        var value = vec4f(0.0);
        for (var i = 0u; i < 4u; i++) {
            let channel = 4u * k + i;
            if channel < params.features {
                let feature = features[g * params.features + channel];
                value[i] = select(0.0, feature, finite(feature));
            } else if channel < params.channels {
                value[i] = depth;
            }
        }
        payload[g * G + k] = value;
    }
}

@compute @workgroup_size(256)
fn project(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_index) lane: u32) {
    let g = (group.y * ROW + group.x) * 256u + lane;
    if g == 0u {
        totals[GAUSSIANS] = params.count;
    }
    if g >= params.count {
        return;
    }
    order[g] = g;
    keys[g] = NOWHERE;
    records[2u * g + 1u] = vec4f(1.0, 0.0, -1.0, -1.0);
    let head = geometry[3u * g];
    let scale = geometry[3u * g + 1u].xyz;
    let rotation = geometry[3u * g + 2u];
    // An infinite opacity counts as 1.
    let given = bitcast<u32>(head.w);
    let opacity = select(select(head.w, 0.0, (given & 0x7fffffffu) > 0x7f800000u), 1.0, given == 0x7f800000u);
    if !(finite3(head.xyz) && finite3(scale) && finite4(rotation) && opacity >= ALPHA_MIN && all(scale >= vec3f(0.0))) {
        return;
    }
    let f = factors(head.xyz, scale, rotation);
    if !(finite(f.in_camera.z) && f.in_camera.z > params.near) {
        return;
    }
    let area = cross(f.a[0], f.a[1]);
    let xx = dot(f.a[0], f.a[0]);
    let yy = dot(f.a[1], f.a[1]);
    let xy = dot(f.a[0], f.a[1]);
    let det = dot(area, area) + (xx + yy + params.low_pass) * params.low_pass;
    let steepness = 1.0 / (yy + params.low_pass);
    let bounded = min(opacity, 1.0);
    let reach = max(log2(bounded * 255.0), 0.0) * (2.0 * 0.6931472);
    let mean = f.free * params.lens.xy + params.lens.zw;
    let variance = det * steepness;
    let shear = xy * steepness;
    let variance_x = variance + shear * shear / steepness;
    let usable = finite(mean.x) && finite(mean.y) && finite(variance) && variance > 0.0 && finite(shear)
        && finite(steepness) && steepness > 0.0 && finite(reach * variance_x) && finite(reach / steepness);
    if !usable {
        return;
    }
    records[2u * g] = vec4f(mean, variance, shear);
    records[2u * g + 1u] = vec4f(steepness, log2(bounded), reach, -0.5 * LOG2_E / variance);
    keys[g] = bitcast<u32>(f.in_camera.z);
    write_payload(g, f.in_camera.z);
}

// Gradient of the given quaternion from that of its rotation matrix' columns.
fn rotation_gradient(unit: vec4f, inverse_norm: f32, d: array<vec3f, 3>) -> vec4f {
    let w = unit.x;
    let x = unit.y;
    let y = unit.z;
    let z = unit.w;
    let twist = vec3f(d[1].z - d[2].y, d[2].x - d[0].z, d[0].y - d[1].x);
    let xy = d[1].x + d[0].y;
    let xz = d[2].x + d[0].z;
    let yz = d[2].y + d[1].z;
    let on_unit = 2.0 * vec4f(
        x * twist.x + y * twist.y + z * twist.z,
        -2.0 * x * (d[1].y + d[2].z) + y * xy + z * xz + w * twist.x,
        x * xy - 2.0 * y * (d[0].x + d[2].z) + z * yz + w * twist.y,
        x * xz + y * yz - 2.0 * z * (d[0].x + d[1].y) + w * twist.z,
    );
    return (on_unit - unit * dot(unit, on_unit)) * inverse_norm;
}

// Gradient of the camera-space centre, through the projected centre, the Jacobian's rows and the depth.
fn camera_gradient(f: Factors, on_mean: vec2f, on_depth: f32, on_t: array<vec3f, 2>) -> vec3f {
    var out = vec3f(0.0, 0.0, on_depth);
    for (var k = 0u; k < 2u; k++) {
        let on_diagonal = dot(on_t[k], params.rows[k].xyz);
        let on_last = dot(on_t[k], params.rows[2].xyz);
        let scaled = f.inverse_z * params.lens[k];
        let is_free = f.free[k] >= params.bounds[k] && f.free[k] <= params.bounds[k + 2u];
        let on_free = on_mean[k] * params.lens[k] - select(0.0, scaled * on_last, is_free);
        out[k] = on_free * f.inverse_z;
        out.z += -on_free * f.free[k] * f.inverse_z + (on_last * f.slope[k] - on_diagonal) * scaled * f.inverse_z;
    }
    return out;
}

@compute @workgroup_size(64)
fn project_backward(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_index) lane: u32) {
    let g = (group.y * ROW + group.x) * 64u + lane;
    if g >= params.count {
        return;
    }
    let span = spans[g];
    var head = array<vec4f, 2>();
    var on_channels = array<vec4f, G>();
    for (var i = span.x; i < span.x + span.y; i++) {
        let at = i * (2u + G);
        head[0] += slots[at];
        head[1] += slots[at + 1u];
        for (var k = 0u; k < G; k++) {
            on_channels[k] += slots[at + 2u + k];
        }
    }
    var on_depth = 0.0;
    if params.channels > params.features {
        on_depth = on_channels[params.features / 4u][params.features % 4u];
    }
    for (var k = 0u; k < G; k++) {
        on_features[g * G + k] = on_channels[k];
    }
    for (var k = 0u; k < 4u; k++) {
        on_geometry[4u * g + k] = vec4f(0.0);
    }
    let record = records[2u * g];
    let rest = records[2u * g + 1u];
    // What is not drawn has no reach.
    if rest.z < 0.0 {
        return;
    }
    let variance = record.z;
    let s = record.w;
    let e = rest.x;
    let a = 1.0 / variance;
    // Σ dp·{1, u, u², dy}, Σ dp·{u·dy, dy²}, Σ weight.
    let on_mean = vec2f(a * head[0].y, e * head[0].w - a * s * head[0].y);
    let gv = 0.5 * a * a * head[0].z;
    let gs = a * head[1].x;
    let ge = -0.5 * head[1].y;
    let gxx = gv;
    let gxy = e * gs - 2.0 * s * gv;
    let gyy = s * s * gv - s * e * gs - e * e * ge;
    let given = geometry[3u * g];
    let scale = geometry[3u * g + 1u].xyz;
    let f = factors(given.xyz, scale, geometry[3u * g + 2u]);
    let on_a0 = 2.0 * gxx * f.a[0] + gxy * f.a[1];
    let on_a1 = 2.0 * gyy * f.a[1] + gxy * f.a[0];
    var on_scale = vec3f(0.0);
    var on_axes = array<vec3f, 3>();
    var on_t = array<vec3f, 2>();
    for (var j = 0u; j < 3u; j++) {
        let column = f.t[0] * on_a0[j] + f.t[1] * on_a1[j];
        on_scale[j] = dot(f.axes[j], column);
        on_axes[j] = column * scale[j];
        on_t[0] += scale[j] * on_a0[j] * f.axes[j];
        on_t[1] += scale[j] * on_a1[j] * f.axes[j];
    }
    let c = camera_gradient(f, on_mean, on_depth, on_t);
    let on_world = c.x * params.rows[0].xyz + c.y * params.rows[1].xyz + c.z * params.rows[2].xyz;
    // Nothing flows where the opacity was clamped.
    let on_opacity = select(0.0, head[0].x / exp2(rest.y), given.w <= 1.0);
    let radius = sqrt(rest.z * max(variance + s * s / e, 1.0 / e));
    on_geometry[4u * g] = vec4f(on_world, on_opacity);
    on_geometry[4u * g + 1u] = vec4f(on_scale, head[1].z);
    on_geometry[4u * g + 2u] = rotation_gradient(f.unit, f.inverse_norm, on_axes);
    on_geometry[4u * g + 3u] = vec4f(on_mean, radius, 0.0);
}
