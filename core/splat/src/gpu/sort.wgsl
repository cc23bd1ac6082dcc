// A stable radix sort of (key, value) pairs by eight bits a pass, without subgroups and without float or order-dependent
// atomics. A workgroup takes a block of 2048 pairs, 256 at a time: each lane sets its bit in the mask of its digit, and
// its rank is the number of bits below its own. Twin of bin.rs' `order_by_depth`.

struct Pass {
    // Bit of the key at which the digit starts.
    shift: u32,
    // Word of `totals` that holds the number of pairs.
    word: u32,
    // Blocks in a row of the table of counts.
    stride: u32,
    // 1 where a pair's value is its own index, whatever `values` holds.
    indexed: u32,
}

@group(0) @binding(0) var<uniform> digit_pass: Pass;
@group(0) @binding(1) var<storage, read> totals: array<u32>;
@group(0) @binding(2) var<storage, read> keys: array<u32>;
@group(0) @binding(3) var<storage, read> values: array<u32>;
// Pairs of each digit (row) in each block (column); after `offsets`, those in the blocks before.
@group(0) @binding(4) var<storage, read_write> table: array<u32>;
@group(0) @binding(5) var<storage, read_write> digits: array<u32>;
@group(0) @binding(6) var<storage, read_write> keys_out: array<u32>;
@group(0) @binding(7) var<storage, read_write> values_out: array<u32>;

const EACH: u32 = 8u;
const BLOCK: u32 = 2048u;
// Words of a digit's mask of 256 lanes.
const WORDS: u32 = 8u;

var<workgroup> bins: array<atomic<u32>, 256>;
var<workgroup> starts: array<u32, 256>;
var<workgroup> masks: array<atomic<u32>, 2048>;

fn digit_of(key: u32) -> u32 {
    return (key >> digit_pass.shift) & 255u;
}

@compute @workgroup_size(256)
fn tally(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_index) lane: u32) {
    let block = group.y * ROW + group.x;
    let count = totals[digit_pass.word];
    atomicStore(&bins[lane], 0u);
    workgroupBarrier();
    for (var k = 0u; k < EACH; k++) {
        let i = block * BLOCK + k * 256u + lane;
        if i < count {
            atomicAdd(&bins[digit_of(keys[i])], 1u);
        }
    }
    workgroupBarrier();
    if block < digit_pass.stride {
        table[lane * digit_pass.stride + block] = atomicLoad(&bins[lane]);
    }
}

// One workgroup a digit.
@compute @workgroup_size(256)
fn offsets(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_index) lane: u32) {
    let blocks = (totals[digit_pass.word] + BLOCK - 1u) / BLOCK;
    let row = group.x * digit_pass.stride;
    var carry = 0u;
    for (var base = 0u; base < blocks; base += 256u) {
        let block = base + lane;
        var value = 0u;
        if block < blocks {
            value = table[row + block];
        }
        let ahead = scan(lane, value);
        if block < blocks {
            table[row + block] = carry + ahead;
        }
        carry += scanned[255];
        workgroupBarrier();
    }
    if lane == 0u {
        digits[group.x] = carry;
    }
}

@compute @workgroup_size(256)
fn scatter(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_index) lane: u32) {
    let block = group.y * ROW + group.x;
    let count = totals[digit_pass.word];
    var own = 0u;
    if block < digit_pass.stride {
        own = table[lane * digit_pass.stride + block];
    }
    starts[lane] = scan(lane, digits[lane]) + own;
    for (var w = 0u; w < WORDS; w++) {
        atomicStore(&masks[lane * WORDS + w], 0u);
    }
    for (var k = 0u; k < EACH; k++) {
        workgroupBarrier();
        let i = block * BLOCK + k * 256u + lane;
        let has = i < count;
        var key = 0u;
        if has {
            key = keys[i];
        }
        let digit = digit_of(key);
        if has {
            atomicOr(&masks[digit * WORDS + lane / 32u], 1u << (lane % 32u));
        }
        workgroupBarrier();
        var rank = 0u;
        var all = 0u;
        if has {
            for (var w = 0u; w < WORDS; w++) {
                let mask = atomicLoad(&masks[digit * WORDS + w]);
                let below = select(select(0u, mask & ((1u << (lane % 32u)) - 1u), w == lane / 32u), mask, w < lane / 32u);
                rank += countOneBits(below);
                all += countOneBits(mask);
            }
            let to = starts[digit] + rank;
            keys_out[to] = key;
            values_out[to] = i;
            if digit_pass.indexed == 0u {
                values_out[to] = values[i];
            }
        }
        workgroupBarrier();
        if has && rank == 0u {
            starts[digit] += all;
            for (var w = 0u; w < WORDS; w++) {
                atomicStore(&masks[digit * WORDS + w], 0u);
            }
        }
    }
}
