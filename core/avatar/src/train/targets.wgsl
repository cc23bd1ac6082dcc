// What a step is compared with, from a frame as the device keeps it, a pixel a thread. Twin of `Level::target` of
// targets.rs.

struct Level {
    width: u32,
    height: u32,
    // Source pixels along each side of one pixel.
    factor: u32,
    source_width: u32,
}

@group(0) @binding(0) var<uniform> level: Level;
// Straight sRGB and matte, eight bits each, red lowest.
@group(0) @binding(1) var<storage, read> frame: array<u32>;
@group(0) @binding(2) var<storage, read_write> wanted: array<vec4f>;

@compute @workgroup_size(256)
fn unfold(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_index) lane: u32) {
    let pixel = (group.y * ROW + group.x) * 256u + lane;
    if pixel >= level.width * level.height {
        return;
    }
    let x = pixel % level.width * level.factor;
    let y = pixel / level.width * level.factor;
    let share = 1.0 / f32(level.factor * level.factor) / 255.0;
    var sum = vec4f(0.0);
    for (var dy = 0u; dy < level.factor; dy++) {
        for (var dx = 0u; dx < level.factor; dx++) {
            let word = frame[(y + dy) * level.source_width + x + dx];
            let codes = vec3f(vec3u(word, word >> 8u, word >> 16u) & vec3u(255u));
            let alpha = f32(word >> 24u) * share;
            sum += vec4f(codes / 255.0 * alpha, alpha);
        }
    }
    wanted[pixel] = sum;
}
