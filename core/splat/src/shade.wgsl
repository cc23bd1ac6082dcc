// Deferred shading and its derivative, a pixel a lane. Twin of shade.rs (the formulas and why), harmonics.rs (the 25
// functions and their gradients), brdf.rs (the two look-ups) and transfer.rs (sRGB).
//
// The picture is that of raster.wgsl: nine channels, albedo 3, normal 3, roughness, reflectance, transmittance.

@group(0) @binding(0) var<uniform> params: Params;
// 25 coefficients of irradiance over π, then 25 of radiance; RGB.
@group(0) @binding(1) var<storage, read> light: array<vec4f>;
// The table of the split sum (64 × 64 × 2), then the lobe's shares (65 × 5).
@group(0) @binding(2) var<storage, read> tables: array<f32>;
@group(0) @binding(3) var<storage, read> picture: array<vec4f>;
// Linear RGB over black, and transmittance.
@group(0) @binding(4) var<storage, read_write> linear: array<vec4f>;
// Straight sRGB and matte, eight bits each, red lowest.
@group(0) @binding(5) var<storage, read_write> codes: array<u32>;

// The same, sRGB-encoded.
@group(0) @binding(6) var<storage, read_write> image: array<vec4f>;
// Gradient of the loss with respect to `image`.
@group(0) @binding(7) var<storage, read> on_image: array<vec4f>;
// That with respect to the picture, for raster.wgsl.
@group(0) @binding(8) var<storage, read_write> gradient: array<vec4f>;
// 25 a tile of pixels: with respect to the light's coefficients.
@group(0) @binding(9) var<storage, read_write> on_light: array<vec4f>;
@group(0) @binding(10) var<storage, read_write> on_radiance: array<vec4f>;

const COUNT: u32 = 25u;
const SIZE: u32 = 64u;
const NODES: u32 = 65u;
const BANDS: u32 = 5u;
const ALPHA_SHADED: f32 = 0.001953125;
const LIGHT_SOFTNESS: f32 = 2e-3;
const NORMAL_SOFTNESS: f32 = 1e-12;
const COSINE_MIN: f32 = 1e-3;
const GRAZING_GAIN: f32 = 50.0;
const KNEE: f32 = 0.0031308;
const COSINE_BANDS = array<f32, 5>(1.0, 0.6666667, 0.25, 0.0, -0.041666667);
const BAND_OF = array<u32, 25>(0, 1, 1, 1, 2, 2, 2, 2, 2, 3, 3, 3, 3, 3, 3, 3, 4, 4, 4, 4, 4, 4, 4, 4, 4);

fn basis(d: vec3f) -> array<f32, 25> {
    let x = d.x;
    let y = d.y;
    let z = d.z;
    let xx = x * x;
    let yy = y * y;
    let zz = z * z;
    let difference = xx - yy;
    let three_x = 3.0 * xx - yy;
    let three_y = xx - 3.0 * yy;
    let z5 = 5.0 * zz - 1.0;
    let z7 = 7.0 * zz - 1.0;
    let z73 = 7.0 * zz - 3.0;
    return array<f32, 25>(
        0.2820948,
        0.4886025 * y,
        0.4886025 * z,
        0.4886025 * x,
        1.0925484 * x * y,
        1.0925484 * y * z,
        0.31539157 * (3.0 * zz - 1.0),
        1.0925484 * x * z,
        0.5462742 * difference,
        0.5900436 * y * three_x,
        2.8906114 * x * y * z,
        0.4570458 * y * z5,
        0.37317633 * z * (5.0 * zz - 3.0),
        0.4570458 * x * z5,
        1.4453057 * z * difference,
        0.5900436 * x * three_y,
        2.503343 * x * y * difference,
        1.7701308 * y * z * three_x,
        0.9461747 * x * y * z7,
        0.6690465 * y * z * z73,
        0.10578555 * (zz * (35.0 * zz - 30.0) + 3.0),
        0.6690465 * x * z * z73,
        0.47308735 * difference * z7,
        1.7701308 * x * z * three_y,
        0.6258357 * (xx * three_y - yy * three_x),
    );
}

// Gradient at a direction of the sum of `w[i]` times the functions.
fn basis_gradient(d: vec3f, w: array<f32, 25>) -> vec3f {
    let x = d.x;
    let y = d.y;
    let z = d.z;
    let xx = x * x;
    let yy = y * y;
    let zz = z * z;
    let difference = xx - yy;
    let three_x = 3.0 * xx - yy;
    let three_y = xx - 3.0 * yy;
    let z5 = 5.0 * zz - 1.0;
    let z7 = 7.0 * zz - 1.0;
    let z73 = 7.0 * zz - 3.0;
    var g = 0.4886025 * vec3f(w[3], w[1], w[2]);
    g += 1.0925484 * (w[4] * vec3f(y, x, 0.0) + w[5] * vec3f(0.0, z, y) + w[7] * vec3f(z, 0.0, x));
    g.z += 0.31539157 * w[6] * 6.0 * z;
    g += 0.5462742 * w[8] * vec3f(2.0 * x, -2.0 * y, 0.0);
    g += 0.5900436 * w[9] * vec3f(6.0 * x * y, 3.0 * difference, 0.0);
    g += 2.8906114 * w[10] * vec3f(y * z, x * z, x * y);
    g += 0.4570458 * (w[11] * vec3f(0.0, z5, 10.0 * y * z) + w[13] * vec3f(z5, 0.0, 10.0 * x * z));
    g.z += 0.37317633 * w[12] * (15.0 * zz - 3.0);
    g += 1.4453057 * w[14] * vec3f(2.0 * x * z, -2.0 * y * z, difference);
    g += 0.5900436 * w[15] * vec3f(3.0 * difference, -6.0 * x * y, 0.0);
    g += 2.503343 * w[16] * vec3f(y * three_x, x * three_y, 0.0);
    g += 1.7701308 * w[17] * vec3f(6.0 * x * y * z, 3.0 * z * difference, y * three_x);
    g += 0.9461747 * w[18] * vec3f(y * z7, x * z7, 14.0 * x * y * z);
    g += 0.6690465 * w[19] * vec3f(0.0, z * z73, y * (21.0 * zz - 3.0));
    g.z += 0.10578555 * w[20] * z * (140.0 * zz - 60.0);
    g += 0.6690465 * w[21] * vec3f(z * z73, 0.0, x * (21.0 * zz - 3.0));
    g += 0.47308735 * w[22] * vec3f(2.0 * x * z7, -2.0 * y * z7, 14.0 * z * difference);
    g += 1.7701308 * w[23] * vec3f(3.0 * z * difference, -6.0 * x * y * z, x * three_y);
    g += 0.6258357 * w[24] * vec3f(4.0 * x * three_y, -4.0 * y * three_x, 0.0);
    return g;
}

struct Brdf {
    // Scale and bias, and their slopes.
    value: vec2f,
    by_cosine: vec2f,
    by_roughness: vec2f,
}

// Bilinear; half a texel at each edge goes on along the outermost cell.
fn sample_brdf(cosine: f32, roughness: f32) -> Brdf {
    let t = vec2f(cosine, roughness) * f32(SIZE) - 0.5;
    let cell = min(vec2u(max(t, vec2f(0.0))), vec2u(SIZE - 2u));
    let f = t - vec2f(cell);
    let at = 2u * (cell.y * SIZE + cell.x);
    let a = vec2f(tables[at], tables[at + 1u]);
    let b = vec2f(tables[at + 2u], tables[at + 3u]);
    let below = at + 2u * SIZE;
    let c = vec2f(tables[below], tables[below + 1u]);
    let d = vec2f(tables[below + 2u], tables[below + 3u]);
    let low = a + f.x * (b - a);
    let high = c + f.x * (d - c);
    let left = a + f.y * (c - a);
    let right = b + f.y * (d - b);
    return Brdf(low + f.y * (high - low), f32(SIZE) * (right - left), f32(SIZE) * (high - low));
}

struct Lobe {
    share: array<f32, 5>,
    slope: array<f32, 5>,
}

fn sample_lobe(roughness: f32) -> Lobe {
    let t = roughness * f32(NODES - 1u);
    let cell = min(u32(t), NODES - 2u);
    var out: Lobe;
    for (var l = 0u; l < BANDS; l++) {
        let at = 2u * SIZE * SIZE + cell * BANDS + l;
        let rise = tables[at + BANDS] - tables[at];
        out.share[l] = tables[at] + (t - f32(cell)) * rise;
        out.slope[l] = f32(NODES - 1u) * rise;
    }
    return out;
}

fn positive(x: vec3f) -> vec3f {
    return 0.5 * (x + sqrt(x * x + LIGHT_SOFTNESS * LIGHT_SOFTNESS));
}

fn positive_slope(x: vec3f) -> vec3f {
    return 0.5 * (1.0 + x / sqrt(x * x + LIGHT_SOFTNESS * LIGHT_SOFTNESS));
}

struct Surface {
    albedo: vec3f,
    normal: vec3f,
    inverse_length: f32,
    view: vec3f,
    facing: f32,
    mirrored: vec3f,
    alpha: f32,
    inverse_alpha: f32,
    roughness: f32,
    reflectance: f32,
}

fn transmittance_at(index: u32) -> f32 {
    // With one group the picture is colour itself.
    if G == 1u {
        return picture[index].w;
    }
    return picture[2u * params.width * params.height + index].x;
}

fn surface_at(at: vec2u) -> Surface {
    let pixels = params.width * params.height;
    let index = at.y * params.width + at.x;
    let a = picture[index];
    let b = picture[pixels + index];
    var s: Surface;
    s.albedo = a.rgb;
    s.alpha = 1.0 - transmittance_at(index);
    s.inverse_alpha = 1.0 / clamp(s.alpha, ALPHA_SHADED, 1.0);
    let raw = vec3f(a.w, b.xy);
    s.inverse_length = 1.0 / sqrt(dot(raw, raw) + NORMAL_SOFTNESS);
    s.normal = raw * s.inverse_length;
    let ray = (vec2f(at) + 0.5 - params.lens.zw) / params.lens.xy;
    s.view = -normalize(params.rows[0].xyz * ray.x + params.rows[1].xyz * ray.y + params.rows[2].xyz);
    s.facing = dot(s.normal, s.view);
    s.mirrored = 2.0 * s.facing * s.normal - s.view;
    s.roughness = b.z * s.inverse_alpha;
    s.reflectance = b.w * s.inverse_alpha;
    return s;
}

struct Lit {
    diffuse: vec3f,
    specular: vec3f,
}

fn light_up(at_normal: array<f32, 25>, at_mirrored: array<f32, 25>, lobe: Lobe) -> Lit {
    var lit: Lit;
    for (var i = 0u; i < COUNT; i++) {
        lit.diffuse += at_normal[i] * light[i].rgb;
        lit.specular += at_mirrored[i] * lobe.share[BAND_OF[i]] * light[COUNT + i].rgb;
    }
    return lit;
}

// Linear RGB over black of the pixel at `at`; black where there is nothing.
fn shaded(at: vec2u) -> vec3f {
    if G == 1u {
        return picture[at.y * params.width + at.x].rgb;
    }
    let s = surface_at(at);
    if !(s.alpha >= ALPHA_SHADED) {
        return vec3f(0.0);
    }
    let roughness = clamp(s.roughness, 0.0, 1.0);
    let brdf = sample_brdf(clamp(s.facing, COSINE_MIN, 1.0), roughness);
    let lit = light_up(basis(s.normal), basis(s.mirrored), sample_lobe(roughness));
    let f0 = clamp(s.reflectance, 0.0, 1.0);
    let k = f0 * brdf.value.x + clamp(f0 * GRAZING_GAIN, 0.0, 1.0) * brdf.value.y;
    return s.albedo * (1.0 - k) * positive(lit.diffuse) + k * s.alpha * positive(lit.specular);
}

fn encoded(linear: vec3f) -> vec3f {
    let power = pow(max(linear, vec3f(KNEE)), vec3f(1.0 / 2.4));
    return select(1.055 * power - 0.055, 12.92 * linear, linear < vec3f(KNEE));
}

fn encoded_slope(linear: vec3f) -> vec3f {
    let safe = max(linear, vec3f(KNEE));
    return select(1.055 / 2.4 * pow(safe, vec3f(1.0 / 2.4)) / safe, vec3f(12.92), linear < vec3f(KNEE));
}

fn code(unit: f32) -> u32 {
    return u32(clamp(unit * 255.0 + 0.5, 0.0, 255.0));
}

@compute @workgroup_size(16, 16)
fn shade(@builtin(global_invocation_id) at: vec3u) {
    if at.x < params.width && at.y < params.height {
        let index = at.y * params.width + at.x;
        let color = shaded(at.xy);
        linear[index] = vec4f(color, transmittance_at(index));
        image[index] = vec4f(encoded(color), transmittance_at(index));
    }
}

// Divided by the matte as it is stored, so that compositing gives back what was rendered.
@compute @workgroup_size(16, 16)
fn present(@builtin(global_invocation_id) at: vec3u) {
    if at.x < params.width && at.y < params.height {
        let index = at.y * params.width + at.x;
        let matte = code(1.0 - transmittance_at(index));
        var out = 0u;
        if matte > 0u {
            let straight = encoded(shaded(at.xy)) * (255.0 / f32(matte));
            out = code(straight.r) | (code(straight.g) << 8u) | (code(straight.b) << 16u) | (matte << 24u);
        }
        codes[index] = out;
    }
}

// What a pixel's gradient gives to the light: along its normal and along its mirrored view.
struct ToLight {
    diffuse: vec3f,
    specular: vec3f,
    at_normal: array<f32, 25>,
    at_mirrored: array<f32, 25>,
}

// Writes the gradient of a pixel's channels.
fn pull_back(at: vec2u) -> ToLight {
    var out: ToLight;
    let pixels = params.width * params.height;
    let index = at.y * params.width + at.x;
    let color = linear[index].rgb;
    let g = on_image[index].rgb * encoded_slope(color);
    let on_transmittance = on_image[index].w;
    if G == 1u {
        gradient[index] = vec4f(g, on_transmittance);
        return out;
    }
    let s = surface_at(at);
    if !(s.alpha >= ALPHA_SHADED) {
        gradient[index] = vec4f(0.0);
        gradient[pixels + index] = vec4f(0.0);
        gradient[2u * pixels + index] = vec4f(on_transmittance, 0.0, 0.0, 0.0);
        return out;
    }
    let roughness = clamp(s.roughness, 0.0, 1.0);
    let brdf = sample_brdf(clamp(s.facing, COSINE_MIN, 1.0), roughness);
    let lobe = sample_lobe(roughness);
    out.at_normal = basis(s.normal);
    out.at_mirrored = basis(s.mirrored);
    let lit = light_up(out.at_normal, out.at_mirrored, lobe);
    let f0 = clamp(s.reflectance, 0.0, 1.0);
    let grazing = clamp(f0 * GRAZING_GAIN, 0.0, 1.0);
    let k = f0 * brdf.value.x + grazing * brdf.value.y;
    let diffuse = positive(lit.diffuse);
    let specular = positive(lit.specular);
    let on_albedo = diffuse * (1.0 - k) * g;
    out.diffuse = s.albedo * (1.0 - k) * g * positive_slope(lit.diffuse);
    out.specular = s.alpha * k * g * positive_slope(lit.specular);
    let on_k = dot(s.alpha * specular - s.albedo * diffuse, g);
    var at_n = array<f32, 25>();
    var at_rho = array<f32, 25>();
    var on_lobe = array<f32, 5>();
    for (var i = 0u; i < COUNT; i++) {
        let band = BAND_OF[i];
        at_n[i] = dot(out.diffuse, light[i].rgb);
        let along = dot(out.specular, light[COUNT + i].rgb);
        on_lobe[band] += out.at_mirrored[i] * along;
        at_rho[i] = along * lobe.share[band];
        out.at_normal[i] *= COSINE_BANDS[band];
        out.at_mirrored[i] *= lobe.share[band];
    }
    let on_mirrored = basis_gradient(s.mirrored, at_rho);
    let held = select(0.0, 1.0, s.facing > COSINE_MIN && s.facing < 1.0);
    let by_cosine = on_k * (f0 * brdf.by_cosine.x + grazing * brdf.by_cosine.y) * held;
    let on_facing = by_cosine + 2.0 * dot(s.normal, on_mirrored);
    let on_normal = basis_gradient(s.normal, at_n) + 2.0 * s.facing * on_mirrored + s.view * on_facing;
    var by_roughness = on_k * (f0 * brdf.by_roughness.x + grazing * brdf.by_roughness.y);
    for (var l = 0u; l < BANDS; l++) {
        by_roughness += lobe.slope[l] * on_lobe[l];
    }
    let on_f0 = on_k * (brdf.value.x + select(0.0, brdf.value.y * GRAZING_GAIN, f0 * GRAZING_GAIN < 1.0));
    let on_roughness = select(0.0, by_roughness * s.inverse_alpha, s.roughness > 0.0 && s.roughness < 1.0);
    let on_reflectance = select(0.0, on_f0 * s.inverse_alpha, s.reflectance > 0.0 && s.reflectance < 1.0);
    let on_alpha = dot(k * specular, g) - on_roughness * s.roughness - on_reflectance * s.reflectance;
    let on_raw = (on_normal - s.normal * dot(s.normal, on_normal)) * s.inverse_length;
    gradient[index] = vec4f(on_albedo, on_raw.x);
    gradient[pixels + index] = vec4f(on_raw.yz, on_roughness, on_reflectance);
    gradient[2u * pixels + index] = vec4f(on_transmittance - on_alpha, 0.0, 0.0, 0.0);
    return out;
}

var<workgroup> shares: array<vec4f, 256>;

// Sum over the workgroup's lanes, in one order; the same for all lanes.
fn sum_of_lanes(lane: u32, value: vec4f) -> vec4f {
    shares[lane] = value;
    workgroupBarrier();
    for (var half = 128u; half > 0u; half /= 2u) {
        if lane < half {
            shares[lane] += shares[lane + half];
        }
        workgroupBarrier();
    }
    let sum = shares[0];
    workgroupBarrier();
    return sum;
}

@compute @workgroup_size(16, 16)
fn shade_backward(@builtin(global_invocation_id) at: vec3u, @builtin(workgroup_id) tile: vec3u,
                  @builtin(local_invocation_index) lane: u32) {
    var own: ToLight;
    if at.x < params.width && at.y < params.height {
        own = pull_back(at.xy);
    }
    // Colour has no light.
    if G > 1u {
        for (var i = 0u; i < COUNT; i++) {
            let value = own.at_normal[i] * own.diffuse + own.at_mirrored[i] * own.specular;
            let sum = sum_of_lanes(lane, vec4f(value, 0.0));
            if lane == 0u {
                on_light[(tile.y * params.columns + tile.x) * COUNT + i] = sum;
            }
        }
    }
}

// One workgroup a coefficient: its sum over the tiles.
@compute @workgroup_size(256)
fn sum_light(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_index) lane: u32) {
    var own = vec4f(0.0);
    for (var tile = lane; tile < params.tiles; tile += 256u) {
        own += on_light[tile * COUNT + group.x];
    }
    let sum = sum_of_lanes(lane, own);
    if lane == 0u {
        on_radiance[group.x] = sum;
    }
}
