// One step of Adam, element by element. Twin of adam.rs: a gradient whose square is not finite leaves its parameter and
// moments as they are; afterwards the value is held to the group's range.

struct Step {
    beta1: f32,
    beta2: f32,
    // Learning rate and guard with the bias corrections in them.
    rate: f32,
    guard: f32,
    low: f32,
    high: f32,
    count: u32,
    spare: u32,
}

@group(0) @binding(0) var<uniform> step: Step;
@group(0) @binding(1) var<storage, read_write> parameters: array<f32>;
@group(0) @binding(2) var<storage, read> gradients: array<f32>;
// First and second moment.
@group(0) @binding(3) var<storage, read_write> moments: array<vec2f>;

@compute @workgroup_size(256)
fn descend(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_index) lane: u32) {
    let i = (group.y * ROW + group.x) * 256u + lane;
    if i >= step.count {
        return;
    }
    let gradient = gradients[i];
    // Larger than the root of the largest number: its square is not finite.
    if !finite(gradient) || abs(gradient) > 1.8446742e19 {
        return;
    }
    let old = moments[i];
    let now = old + vec2f(1.0 - step.beta1, 1.0 - step.beta2) * (vec2f(gradient, gradient * gradient) - old);
    moments[i] = now;
    parameters[i] = clamp(parameters[i] - step.rate * now.x / (sqrt(now.y) + step.guard), step.low, step.high);
}
