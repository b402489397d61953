// Shared by forward and render: the sums Σwc and Σw of one sample of a tile.

@group(0) @binding(1) var<storage, read> splats: array<Splat>;
@group(0) @binding(2) var<storage, read> starts: array<u32>;
@group(0) @binding(3) var<storage, read> sorted: array<u32>;
@group(0) @binding(4) var<storage, read> status: array<u32>;

struct Sums {
    color: vec4f,
    weight: f32,
}

var<workgroup> places: array<vec4f, 256>;
// run; the amplitude.
var<workgroup> runs: array<vec2f, 256>;
var<workgroup> colors: array<vec4f, 256>;

// Called by all 256 threads of a tile's workgroup, each for the sample in column `x` of row `y`.
fn sum_tile(tile: u32, local: u32, x: f32, y: f32) -> Sums {
    var sums = Sums(vec4f(0.0), 0.0);
    let first = starts[tile];
    let end = starts[tile + 1u];
    for (var base = first; base < end; base += 256u) {
        if (base + local < end) {
            let splat = splats[sorted[base + local]];
            places[local] = splat.place;
            runs[local] = vec2f(splat.shape.x, splat.extent.z);
            colors[local] = splat.color;
        }
        workgroupBarrier();
        let count = min(256u, end - base);
        for (var j = 0u; j < count; j++) {
            let place = places[j];
            let dx = x - place.x;
            let u = place.z * (y - place.y) - place.w * dx;
            let run = runs[j];
            let v = run.x * dx;
            let q = u * u + v * v;
            if (q < SUPPORT) {
                let w = run.y * max(exp2(-q) - CUTOFF_WEIGHT, 0.0);
                sums.color += w * colors[j];
                sums.weight += w;
            }
        }
        workgroupBarrier();
    }
    return sums;
}
