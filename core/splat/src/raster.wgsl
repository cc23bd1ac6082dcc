// Compositing, forward and backward. Twin of raster.rs: the same arithmetic, so that both take the same decisions.
// A pixel's channels lie in groups of four, group after group (G × height × width); transmittance is the last channel,
// and the feature that a splat gives it is 0.
//
// Backward needs no reduction over pixels and no atomics. `states` walks a tile front to back, a pixel a lane, and keeps
// each pixel's transmittance and what lies behind at every 32nd entry. `backward` gives a workgroup one such bucket of 32
// entries, an entry a lane: the tile's 256 pixels pass through the lanes like beads on a string, each lane handing a
// pixel's state to the next, and each adds up its own entry's gradient in pixel order, in registers.

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> records: array<vec4f>;
@group(0) @binding(2) var<storage, read> payload: array<vec4f>;
// Gaussian and slot of each entry, tile after tile.
@group(0) @binding(3) var<storage, read> entries: array<vec2u>;
@group(0) @binding(4) var<storage, read> ranges: array<vec2u>;
@group(0) @binding(5) var<storage, read_write> picture: array<vec4f>;
@group(0) @binding(6) var<storage, read> finished: array<vec4f>;
@group(0) @binding(7) var<storage, read> gradient: array<vec4f>;
@group(0) @binding(8) var<storage, read_write> states_out: array<vec2f>;
// One plus the tile of each bucket, with DEAD set where all pixels were finished before it; 0 where there is none.
@group(0) @binding(9) var<storage, read_write> buckets_out: array<u32>;
@group(0) @binding(10) var<storage, read> states_in: array<vec2f>;
@group(0) @binding(11) var<storage, read> buckets_in: array<u32>;
// Σ dp·{1, u, u², dy}; Σ dp·{u·dy, dy²}, Σ α·T, spare; G of Σ α·T·g.
@group(0) @binding(12) var<storage, read_write> slots: array<vec4f>;

const BATCH: u32 = 256u;
const BUCKET: u32 = 32u;
const PIXELS: u32 = 256u;
const DEAD: u32 = 0x80000000u;

struct Splat {
    // Centre relative to the tile's first pixel centre.
    mean: vec2f,
    shear: f32,
    steepness: f32,
    peak: f32,
    reach: f32,
    falloff: f32,
}

fn splat_of(g: u32, origin: vec2f) -> Splat {
    let a = records[2u * g];
    let b = records[2u * g + 1u];
    return Splat(a.xy - origin - 0.5, a.w, b.x, b.y, b.z, b.w);
}

struct Alpha {
    // o·e^p before the clamp; 0 where below the cut.
    raw: f32,
    alpha: f32,
    u: f32,
    dy: f32,
}

fn alpha_at(s: Splat, pixel: vec2f) -> Alpha {
    let dy = pixel.y - s.mean.y;
    let fall = s.steepness * dy * dy;
    if fall > s.reach {
        return Alpha(0.0, 0.0, 0.0, 0.0);
    }
    let u = pixel.x - (s.shear * dy + s.mean.x);
    let raw = exp2(u * u * s.falloff + (-0.5 * LOG2_E * fall + s.peak));
    let alpha = min(raw, ALPHA_MAX);
    return Alpha(raw, select(0.0, alpha, alpha >= ALPHA_MIN), u, dy);
}

var<workgroup> batch_a: array<vec4f, 256>;
var<workgroup> batch_b: array<vec4f, 256>;
var<workgroup> batch_id: array<u32, 256>;
var<workgroup> busy: atomic<u32>;
var<workgroup> is_busy: u32;

// Puts the next entries in reach of all lanes; false when every pixel is finished. All lanes call it.
fn load_batch(lane: u32, first: u32, end: u32, origin: vec2f, done: bool) -> bool {
    workgroupBarrier();
    if lane == 0u {
        atomicStore(&busy, 0u);
    }
    workgroupBarrier();
    if !done {
        atomicStore(&busy, 1u);
    }
    if first + lane < end {
        let g = entries[first + lane].x;
        batch_a[lane] = records[2u * g];
        batch_b[lane] = records[2u * g + 1u];
        batch_id[lane] = g;
    }
    workgroupBarrier();
    if lane == 0u {
        is_busy = atomicLoad(&busy);
    }
    return workgroupUniformLoad(&is_busy) != 0u;
}

fn splat_in_batch(j: u32, origin: vec2f) -> Splat {
    let a = batch_a[j];
    let b = batch_b[j];
    return Splat(a.xy - origin - 0.5, a.w, b.x, b.y, b.z, b.w);
}

@compute @workgroup_size(16, 16)
fn forward(@builtin(workgroup_id) tile: vec3u, @builtin(local_invocation_id) place: vec3u,
           @builtin(local_invocation_index) lane: u32) {
    let origin = vec2f(tile.xy * TILE);
    let at = tile.xy * TILE + place.xy;
    let inside = at.x < params.width && at.y < params.height;
    let pixel = vec2f(place.xy);
    let range = ranges[tile.y * params.columns + tile.x];
    var transmittance = 1.0;
    var done = !inside;
    var sum = array<vec4f, G>();
    for (var first = range.x; first < range.y; first += BATCH) {
        if !load_batch(lane, first, range.y, origin, done) {
            break;
        }
        let count = min(BATCH, range.y - first);
        for (var j = 0u; j < count && !done; j++) {
            let a = alpha_at(splat_in_batch(j, origin), pixel);
            if a.alpha > 0.0 {
                let next = transmittance - a.alpha * transmittance;
                if next < TRANSMITTANCE_MIN {
                    done = true;
                } else {
                    let weight = a.alpha * transmittance;
                    let g = batch_id[j] * G;
                    for (var k = 0u; k < G; k++) {
                        sum[k] += weight * payload[g + k];
                    }
                    transmittance = next;
                }
            }
        }
    }
    if inside {
        sum[params.channels / 4u][params.channels % 4u] = transmittance;
        let index = at.y * params.width + at.x;
        for (var k = 0u; k < G; k++) {
            picture[k * params.width * params.height + index] = sum[k];
        }
    }
}

@compute @workgroup_size(16, 16)
fn states(@builtin(workgroup_id) tile: vec3u, @builtin(local_invocation_id) place: vec3u,
          @builtin(local_invocation_index) lane: u32) {
    let origin = vec2f(tile.xy * TILE);
    let at = tile.xy * TILE + place.xy;
    let inside = at.x < params.width && at.y < params.height;
    let pixel = vec2f(place.xy);
    let tile_index = tile.y * params.columns + tile.x;
    let range = ranges[tile_index];
    let pixels = params.width * params.height;
    let first_bucket = range.x / BUCKET + tile_index;
    var transmittance = select(-1.0, 1.0, inside);
    var behind = 0.0;
    var toward = array<vec4f, G>();
    if inside {
        for (var k = 0u; k < G; k++) {
            toward[k] = gradient[k * pixels + at.y * params.width + at.x];
            behind += dot(finished[k * pixels + at.y * params.width + at.x], toward[k]);
        }
    }
    var live = 0u;
    for (var first = range.x; first < range.y; first += BATCH) {
        if !load_batch(lane, first, range.y, origin, transmittance < 0.0) {
            break;
        }
        let count = min(BATCH, range.y - first);
        for (var j = 0u; j < count; j++) {
            if j % BUCKET == 0u {
                states_out[(first_bucket + live) * PIXELS + lane] = vec2f(transmittance, behind);
                live++;
            }
            if transmittance < 0.0 {
                continue;
            }
            let a = alpha_at(splat_in_batch(j, origin), pixel);
            if a.alpha > 0.0 {
                let next = transmittance - a.alpha * transmittance;
                if next < TRANSMITTANCE_MIN {
                    transmittance = -transmittance;
                } else {
                    let g = batch_id[j] * G;
                    var own = 0.0;
                    for (var k = 0u; k < G; k++) {
                        own += dot(payload[g + k], toward[k]);
                    }
                    behind -= a.alpha * transmittance * own;
                    transmittance = next;
                }
            }
        }
    }
    let buckets = (range.y - range.x + BUCKET - 1u) / BUCKET;
    for (var k = lane; k < buckets; k += PIXELS) {
        buckets_out[first_bucket + k] = (tile_index + 1u) | select(DEAD, 0u, k < live);
    }
}

var<workgroup> beads: array<array<vec2f, 33>, 2>;

@compute @workgroup_size(32)
fn backward(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_index) lane: u32) {
    let bucket = group.y * ROW + group.x;
    if bucket >= arrayLength(&buckets_in) {
        return;
    }
    let tag = buckets_in[bucket];
    if tag == 0u {
        return;
    }
    let tile = (tag & ~DEAD) - 1u;
    let range = ranges[tile];
    let e = range.x + (bucket - range.x / BUCKET - tile) * BUCKET + lane;
    let has = e < range.y;
    var entry = vec2u(0u);
    if has {
        entry = entries[e];
    }
    let corner = vec2u(tile % params.columns, tile / params.columns) * TILE;
    let pixels = params.width * params.height;
    var feature = array<vec4f, G>();
    var on_feature = array<vec4f, G>();
    var head = array<vec4f, 2>();
    if (tag & DEAD) == 0u {
        var splat: Splat;
        if has {
            splat = splat_of(entry.x, vec2f(corner));
            for (var k = 0u; k < G; k++) {
                feature[k] = payload[entry.x * G + k];
            }
        }
        for (var step = 0u; step < PIXELS + BUCKET - 1u; step++) {
            let p = step - lane;
            let here = step >= lane && p < PIXELS;
            var state = vec2f(-1.0, 0.0);
            if lane == 0u {
                if here {
                    state = states_in[bucket * PIXELS + p];
                }
            } else {
                state = beads[step % 2u][lane];
            }
            if here && has && state.x >= 0.0 {
                let offset = vec2u(p % TILE, p / TILE);
                let a = alpha_at(splat, vec2f(offset));
                if a.alpha > 0.0 {
                    let next = state.x - a.alpha * state.x;
                    if next < TRANSMITTANCE_MIN {
                        state.x = -state.x;
                    } else {
                        let weight = a.alpha * state.x;
                        let index = (corner.y + offset.y) * params.width + corner.x + offset.x;
                        var towards = 0.0;
                        for (var k = 0u; k < G; k++) {
                            let g = gradient[k * pixels + index];
                            towards += dot(feature[k], g);
                            on_feature[k] += weight * g;
                        }
                        let own = weight * towards;
                        state = vec2f(next, state.y - own);
                        // α·dL/dα; nothing flows where α was clamped.
                        let dp = select(0.0, own - a.alpha / (1.0 - a.alpha) * state.y, a.raw < ALPHA_MAX);
                        head[0] += dp * vec4f(1.0, a.u, a.u * a.u, a.dy);
                        head[1] += vec4f(dp * a.u * a.dy, dp * a.dy * a.dy, weight, 0.0);
                    }
                }
            }
            beads[(step + 1u) % 2u][lane + 1u] = state;
            workgroupBarrier();
        }
    }
    if has {
        let at = entry.y * (2u + G);
        slots[at] = head[0];
        slots[at + 1u] = head[1];
        for (var k = 0u; k < G; k++) {
            slots[at + 2u + k] = on_feature[k];
        }
    }
}
