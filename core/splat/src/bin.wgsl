// Which tiles a splat reaches, as a list of (tile, Gaussian) in the order of depth, and each tile's range once the list is
// sorted by tile. Twin of bin.rs; tiles are 16×16 here. The number of entries never leaves the device: `plan` turns it
// into the sizes of the dispatches that follow. A list that does not fit is left empty and its length kept in WANTED.

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> records: array<vec4f>;
@group(0) @binding(2) var<storage, read> keys: array<u32>;
@group(0) @binding(3) var<storage, read> order: array<u32>;
// Entries before the splat at a place of the order of depth, within its block of BLOCK.
@group(0) @binding(4) var<storage, read_write> before: array<u32>;
@group(0) @binding(5) var<storage, read_write> blocks: array<u32>;
@group(0) @binding(6) var<storage, read_write> totals: array<u32>;
// Three words a dispatch.
@group(0) @binding(7) var<storage, read_write> dispatches: array<u32>;
@group(0) @binding(8) var<storage, read_write> spans: array<vec2u>;
@group(0) @binding(9) var<storage, read_write> tiles: array<u32>;
@group(0) @binding(11) var<storage, read_write> owners: array<u32>;
@group(0) @binding(12) var<storage, read> sorted_tiles: array<u32>;
@group(0) @binding(13) var<storage, read> sorted_places: array<u32>;
@group(0) @binding(14) var<storage, read> all_owners: array<u32>;
@group(0) @binding(15) var<storage, read_write> ranges: array<u32>;
// Gaussian and slot of each entry, tile after tile.
@group(0) @binding(16) var<storage, read_write> entries: array<vec2u>;

const EACH: u32 = 8u;
const BLOCK: u32 = 2048u;
const SORT_BLOCK: u32 = 2048u;
// Entries past any buffer: sums are held here, so that none wraps to a small number.
const MOST: u32 = 1u << 30u;
const BUCKET: u32 = 32u;

struct Reach {
    mean: vec2f,
    variance: f32,
    shear: f32,
    steepness: f32,
    reach: f32,
    extent: vec2f,
}

// Range of whole tiles that pixel centres in [low, high] fall in; empty as (1, 0).
fn tile_range(low: f32, high: f32, size: u32) -> vec2i {
    let first = clamp(ceil(low - 0.5 - SLACK_PX), 0.0, 65536.0);
    let last = min(floor(high - 0.5 + SLACK_PX), f32(size) - 1.0);
    if last < 0.0 || first > last {
        return vec2i(1, 0);
    }
    return vec2i(i32(first) / i32(TILE), i32(last) / i32(TILE));
}

fn reach_of(g: u32) -> Reach {
    let a = records[2u * g];
    let b = records[2u * g + 1u];
    let variance_y = 1.0 / b.x;
    let variance_x = a.z + a.w * a.w * variance_y;
    return Reach(a.xy, a.z, a.w, b.x, b.z, sqrt(b.z * vec2f(variance_x, variance_y)));
}

fn rows_of(r: Reach) -> vec2i {
    return tile_range(r.mean.y - r.extent.y, r.mean.y + r.extent.y, params.height);
}

fn edge(r: Reach, dy: f32, sign: f32) -> f32 {
    let rest = max(r.reach - r.steepness * dy * dy, 0.0);
    return r.shear * dy + sign * sqrt(r.variance * rest);
}

// First and last column of tiles of a row of tiles.
fn columns_of(r: Reach, row: i32) -> vec2i {
    let whole = tile_range(r.mean.x - r.extent.x, r.mean.x + r.extent.x, params.width);
    if whole.x >= whole.y {
        return whole;
    }
    let dy_right = r.shear / r.steepness * r.reach / max(r.extent.x, 1e-30);
    let top = f32(row) * f32(TILE);
    let low = max(top + 0.5 - r.mean.y, -r.extent.y);
    let high = max(min(top + f32(TILE) - 0.5 - r.mean.y, r.extent.y), low);
    let right = edge(r, clamp(dy_right, low, high), 1.0);
    let left = edge(r, clamp(-dy_right, low, high), -1.0);
    return tile_range(r.mean.x + left, r.mean.x + right, params.width);
}

// Entries before each splat, block by block. `keys` are those of the Gaussians in the order of depth.
@compute @workgroup_size(256)
fn count(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_index) lane: u32) {
    let block = group.y * ROW + group.x;
    let first = block * BLOCK + lane * EACH;
    var own = array<u32, EACH>();
    var sum = 0u;
    for (var k = 0u; k < EACH; k++) {
        let place = first + k;
        own[k] = sum;
        if place < params.count && keys[place] != NOWHERE {
            let r = reach_of(order[place]);
            let rows = rows_of(r);
            for (var row = rows.x; row <= rows.y; row++) {
                let columns = columns_of(r, row);
                sum += u32(max(columns.y - columns.x + 1, 0));
            }
            // Held so that 256 of these cannot wrap to a small number: nothing as large as that fits a buffer.
            sum = min(sum, 1u << 22u);
        }
    }
    let ahead = scan(lane, sum);
    for (var k = 0u; k < EACH; k++) {
        let place = first + k;
        if place < params.count {
            before[place] = ahead + own[k];
        }
    }
    if lane == 255u {
        blocks[block] = ahead + sum;
    }
}

fn plan_one(at: u32, groups: u32) {
    dispatches[3u * at] = min(groups, ROW);
    dispatches[3u * at + 1u] = (groups + ROW - 1u) / ROW;
    dispatches[3u * at + 2u] = 1u;
}

// Entries before each block, the number of all, and what is to be dispatched over them. One workgroup.
@compute @workgroup_size(256)
fn plan(@builtin(local_invocation_index) lane: u32) {
    let count = (params.count + BLOCK - 1u) / BLOCK;
    var carry = 0u;
    for (var base = 0u; base < count; base += 256u) {
        let block = base + lane;
        var value = 0u;
        if block < count {
            value = min(blocks[block], MOST / 256u);
        }
        let ahead = scan(lane, value);
        if block < count {
            blocks[block] = carry + ahead;
        }
        carry = min(carry + scanned[255], MOST);
        workgroupBarrier();
    }
    if lane == 0u {
        let fits = carry <= params.capacity;
        let entries = select(0u, carry, fits);
        totals[ENTRIES] = entries;
        totals[WANTED] = max(totals[WANTED], carry);
        plan_one(0u, (entries + SORT_BLOCK - 1u) / SORT_BLOCK);
        plan_one(1u, (entries + 255u) / 256u);
        plan_one(2u, select(0u, entries / BUCKET + params.tiles + 1u, entries > 0u));
    }
}

// Writes each splat's entries, in the order of depth.
@compute @workgroup_size(256)
fn emit(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_index) lane: u32) {
    let place = (group.y * ROW + group.x) * 256u + lane;
    if place >= params.count {
        return;
    }
    let g = order[place];
    let first = before[place] + blocks[place / BLOCK];
    var end = totals[ENTRIES];
    if place + 1u < params.count {
        end = min(end, before[place + 1u] + blocks[(place + 1u) / BLOCK]);
    }
    if first >= end {
        spans[g] = vec2u(0u);
        return;
    }
    var at = first;
    let r = reach_of(g);
    let rows = rows_of(r);
    for (var row = rows.x; row <= rows.y; row++) {
        let columns = columns_of(r, row);
        for (var column = columns.x; column <= columns.y && at < end; column++) {
            tiles[at] = u32(row) * params.columns + u32(column);
            owners[at] = g;
            at++;
        }
    }
    // Two compilations of one formula may round apart: what was counted and is not there belongs to no tile.
    spans[g] = vec2u(first, at - first);
    for (; at < end; at++) {
        tiles[at] = params.tiles;
        owners[at] = g;
    }
}

@compute @workgroup_size(256)
fn delimit(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_index) lane: u32) {
    let e = (group.y * ROW + group.x) * 256u + lane;
    let count = totals[ENTRIES];
    if e >= count {
        return;
    }
    let tile = sorted_tiles[e];
    let place = sorted_places[e];
    entries[e] = vec2u(all_owners[place], place);
    if tile >= params.tiles {
        return;
    }
    if e == 0u || sorted_tiles[e - 1u] != tile {
        ranges[2u * tile] = e;
    }
    if e + 1u == count || sorted_tiles[e + 1u] != tile {
        ranges[2u * tile + 1u] = e + 1u;
    }
}
