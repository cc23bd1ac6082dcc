// What happened to each Gaussian in a frame, added up between two rounds of density control. Twin of `Statistics::add` of
// density.rs.

struct Round {
    count: u32,
}

@group(0) @binding(0) var<uniform> round: Round;
// Four of four a Gaussian; see project.wgsl.
@group(0) @binding(1) var<storage, read> on_geometry: array<vec4f>;
// Sum of the gradients by the centre in pixels, frames in which it was drawn, its largest share of one, nothing.
@group(0) @binding(2) var<storage, read_write> statistics: array<vec4f>;
@group(0) @binding(3) var<storage, read> status: array<u32>;

@compute @workgroup_size(64)
fn collect(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_index) lane: u32) {
    let g = (group.y * ROW + group.x) * 64u + lane;
    if g >= round.count || status[0] != 0u {
        return;
    }
    let weight = on_geometry[4u * g + 1u].w;
    let pull = on_geometry[4u * g + 3u].xy;
    if weight > 0.0 && finite(pull.x) && finite(pull.y) {
        let old = statistics[g];
        statistics[g] = vec4f(old.x + length(pull), old.y + 1.0, max(old.z, weight), 0.0);
    }
}
