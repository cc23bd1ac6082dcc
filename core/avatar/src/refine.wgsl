// The pose of a training frame: from the tracked numbers and their offsets to what moves the Gaussians, and from the
// gradient of that to a step of the offsets. Twin of refine.rs and of what rig.rs does for it; rig.wgsl stands before this.
//
// One workgroup. A frame's numbers are 18 of the pose (world-from-head rotation and translation, neck, jaw, left eye, right
// eye, three each), then the motion coefficients.

struct Visit {
    frame: u32,
    // Numbers of a frame, at most 128.
    width: u32,
    // Training frames.
    frames: u32,
    // Factor on the rates.
    decay: f32,
    // Rates of rotation, translation, neck, jaw; of the eyes and the coefficients.
    rates: array<vec4f, 2>,
    // Share by which a pose number, and a coefficient, is drawn to its neighbours' cubic.
    smoothing: vec4f,
    // Joints at rest.
    joints: array<vec4f, 5>,
}

@group(0) @binding(0) var<uniform> visit: Visit;
@group(0) @binding(1) var<storage, read> tracked: array<f32>;
// Offsets of all frames, then first moments, then second ones.
@group(0) @binding(2) var<storage, read_write> refined: array<f32>;
@group(0) @binding(3) var<storage, read_write> visits: array<u32>;
@group(0) @binding(4) var<storage, read_write> motion: array<f32>;
@group(0) @binding(5) var<storage, read> on_motion: array<f32>;
@group(0) @binding(6) var<storage, read> status: array<u32>;

const POSE: u32 = 18u;
const JOINT_WORDS: u32 = 60u;
const BETA = vec2f(0.8, 0.95);

fn number(frame: u32, index: u32) -> f32 {
    let at = frame * visit.width + index;
    return tracked[at] + refined[at];
}

fn part(slot: u32) -> vec3f {
    let index = 3u * slot;
    return vec3f(number(visit.frame, index), number(visit.frame, index + 1u), number(visit.frame, index + 2u));
}

// The joint's own turn: neck 1, jaw 2, eyes 3 and 4.
fn own_turn(joint: u32) -> Rigid {
    return turned(part(joint + 1u), visit.joints[joint].xyz);
}

fn root() -> Rigid {
    return Rigid(rotation(part(0u)), part(1u));
}

@compute @workgroup_size(128)
fn pose(@builtin(local_invocation_index) lane: u32) {
    if lane < 5u {
        var own = root();
        if lane >= 1u {
            own = after(own, own_turn(1u));
        }
        if lane >= 2u {
            own = after(own, own_turn(lane));
        }
        for (var row = 0u; row < 3u; row++) {
            let at = 12u * lane + 4u * row;
            motion[at] = own.turn[0][row];
            motion[at + 1u] = own.turn[1][row];
            motion[at + 2u] = own.turn[2][row];
            motion[at + 3u] = own.offset[row];
        }
    }
    if POSE + lane < visit.width {
        motion[JOINT_WORDS + lane] = number(visit.frame, POSE + lane);
    }
}

fn along(joint: u32, tangent: Rigid) -> f32 {
    var sum = 0.0;
    for (var row = 0u; row < 3u; row++) {
        let at = 12u * joint + 4u * row;
        sum += on_motion[at] * tangent.turn[0][row] + on_motion[at + 1u] * tangent.turn[1][row]
            + on_motion[at + 2u] * tangent.turn[2][row] + on_motion[at + 3u] * tangent.offset[row];
    }
    return sum;
}

// With respect to one number of the pose.
fn pose_gradient(index: u32) -> f32 {
    let slot = index / 3u;
    let axis = index % 3u;
    let at_root = root();
    let at_neck = own_turn(1u);
    var tangent = Rigid(mat3x3f(), vec3f(0.0));
    if slot == 1u {
        tangent.offset[axis] = 1.0;
    } else {
        tangent.turn = rotation_derivative(part(slot), axis);
    }
    if slot >= 2u {
        tangent.offset = -(tangent.turn * visit.joints[slot - 1u].xyz);
    }
    if slot >= 3u {
        return along(slot - 1u, tangent_after(after(at_root, at_neck), tangent));
    }
    var sum = 0.0;
    var neck: Rigid;
    if slot == 2u {
        neck = tangent_after(at_root, tangent);
    } else {
        sum = along(0u, tangent);
        neck = after(tangent, at_neck);
    }
    sum += along(1u, neck);
    for (var joint = 2u; joint < 5u; joint++) {
        sum += along(joint, after(neck, own_turn(joint)));
    }
    return sum;
}

// 1 − βⁿ, by multiplication: exact enough at n = 1 too.
fn correction(beta: f32, n: u32) -> f32 {
    var power = 1.0;
    for (var i = 0u; i < min(n, 1000u); i++) {
        power *= beta;
    }
    return 1.0 - power;
}

@compute @workgroup_size(128)
fn refine(@builtin(local_invocation_index) index: u32) {
    let goes = index < visit.width && status[0] == 0u;
    let count = visits[visit.frame] + 1u;
    var gradient = 0.0;
    // All read the pose before any changes it.
    if goes {
        if index < POSE {
            gradient = pose_gradient(index);
        } else {
            gradient = on_motion[JOINT_WORDS + index - POSE];
        }
    }
    storageBarrier();
    workgroupBarrier();
    if !goes {
        return;
    }
    if index == 0u {
        visits[visit.frame] = count;
    }
    let slot = select(6u, index / 3u, index < POSE);
    let rate = visit.rates[slot / 4u][slot % 4u];
    let at = visit.frame * visit.width + index;
    let size = visit.frames * visit.width;
    let decayed = visit.decay * rate;
    // Larger than the root of the largest number: its square is not finite.
    if decayed != 0.0 && finite(gradient) && abs(gradient) < 1.8446742e19 {
        let first = BETA.x * refined[size + at] + (1.0 - BETA.x) * gradient;
        let second = BETA.y * refined[2u * size + at] + (1.0 - BETA.y) * gradient * gradient;
        refined[size + at] = first;
        refined[2u * size + at] = second;
        let scaled = first / correction(BETA.x, count);
        refined[at] -= decayed * scaled / (sqrt(second / correction(BETA.y, count)) + 1e-12);
    }
    let share = select(visit.smoothing.y, visit.smoothing.x, index < POSE);
    let frame = visit.frame;
    if frame < 2u || frame + 2u >= visit.frames || rate == 0.0 || share == 0.0 {
        return;
    }
    let near = number(frame - 1u, index) + number(frame + 1u, index);
    let cubic = (4.0 * near - number(frame - 2u, index) - number(frame + 2u, index)) / 6.0;
    refined[at] += share * (cubic - number(frame, index));
}
