// One step of Adam over groups that lie one after another, element by element. Twin of adam.rs: a gradient whose square is
// not finite leaves its parameter and moments as they are; afterwards the value is held to the group's range. A group of
// rate 0 is left alone, and so is everything once a step was found to have had no room (see loss.wgsl).

struct Step {
    beta1: f32,
    beta2: f32,
    count: u32,
    groups: u32,
    // Where each group ends.
    ends: array<vec4u, 4>,
    // Learning rate and guard with the bias corrections in them, least and largest value.
    rates: array<vec4f, 16>,
}

@group(0) @binding(0) var<uniform> step: Step;
@group(0) @binding(1) var<storage, read_write> parameters: array<f32>;
@group(0) @binding(2) var<storage, read> gradients: array<f32>;
// First moments, then second ones.
@group(0) @binding(3) var<storage, read_write> moments: array<f32>;
@group(0) @binding(4) var<storage, read> status: array<u32>;

@compute @workgroup_size(256)
fn descend(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_index) lane: u32) {
    let i = (group.y * ROW + group.x) * 256u + lane;
    if i >= step.count || status[0] != 0u {
        return;
    }
    var own = 0u;
    while own + 1u < step.groups && i >= step.ends[own / 4u][own % 4u] {
        own++;
    }
    let rate = step.rates[own];
    let gradient = gradients[i];
    // Larger than the root of the largest number: its square is not finite.
    if rate.x == 0.0 || !finite(gradient) || abs(gradient) > 1.8446742e19 {
        return;
    }
    let old = vec2f(moments[i], moments[step.count + i]);
    let now = old + vec2f(1.0 - step.beta1, 1.0 - step.beta2) * (vec2f(gradient, gradient * gradient) - old);
    moments[i] = now.x;
    moments[step.count + i] = now.y;
    parameters[i] = clamp(parameters[i] - rate.x * now.x / (sqrt(now.y) + rate.y), rate.z, rate.w);
}
