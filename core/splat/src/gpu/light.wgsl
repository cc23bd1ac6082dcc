// One step of Adam for the light's coefficients, a lane each, then a pull of bands 1 and higher to zero; and the light as
// shade.wgsl reads it. Twin of what the CPU does with adam.rs and of light.rs' `set`.

struct LightStep {
    beta1: f32,
    beta2: f32,
    // Learning rate and guard with the bias corrections in them.
    rate: f32,
    guard: f32,
    // Factor on the higher bands.
    keep: f32,
    spare: vec3f,
}

@group(0) @binding(0) var<uniform> step: LightStep;
// 25 coefficients of irradiance over π, then 25 of radiance; RGB.
@group(0) @binding(1) var<storage, read_write> light: array<vec4f>;
@group(0) @binding(2) var<storage, read> on_radiance: array<vec4f>;
// 25 first moments, then 25 second ones.
@group(0) @binding(3) var<storage, read_write> moments: array<vec4f>;
@group(0) @binding(4) var<storage, read> status: array<u32>;

const COUNT: u32 = 25u;
const COSINE_BANDS = array<f32, 5>(1.0, 0.6666667, 0.25, 0.0, -0.041666667);
const BAND_OF = array<u32, 25>(0, 1, 1, 1, 2, 2, 2, 2, 2, 3, 3, 3, 3, 3, 3, 3, 4, 4, 4, 4, 4, 4, 4, 4, 4);

@compute @workgroup_size(32)
fn turn_light(@builtin(local_invocation_index) i: u32) {
    if i >= COUNT || status[0] != 0u {
        return;
    }
    var radiance = light[COUNT + i].rgb;
    var first = moments[i].rgb;
    var second = moments[COUNT + i].rgb;
    for (var channel = 0u; channel < 3u; channel++) {
        let gradient = on_radiance[i][channel];
        if finite(gradient) && abs(gradient) <= 1.8446742e19 {
            first[channel] += (1.0 - step.beta1) * (gradient - first[channel]);
            second[channel] += (1.0 - step.beta2) * (gradient * gradient - second[channel]);
            radiance[channel] -= step.rate * first[channel] / (sqrt(second[channel]) + step.guard);
        }
    }
    if i > 0u {
        radiance *= step.keep;
    }
    moments[i] = vec4f(first, 0.0);
    moments[COUNT + i] = vec4f(second, 0.0);
    light[COUNT + i] = vec4f(radiance, 0.0);
    light[i] = vec4f(radiance * COSINE_BANDS[BAND_OF[i]], 0.0);
}
