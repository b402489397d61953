// Converts sums to the gradient in the Gaussian's own frame, and takes one step of Adam there.

@group(0) @binding(1) var<storage, read_write> primitives: array<f32>;
@group(0) @binding(2) var<storage, read> moments: array<f32>;
// First and second moments of the gradient, nine per primitive.
@group(0) @binding(3) var<storage, read_write> first: array<f32>;
@group(0) @binding(4) var<storage, read_write> second: array<f32>;
@group(0) @binding(5) var<storage, read_write> status: array<u32>;

@compute @workgroup_size(64)
fn adam(@builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u, @builtin(local_invocation_index) local: u32) {
    let i = group_index(group, groups) * 64u + local;
    if (i >= scene.primitives - scene.frozen || status[1] != 0u) { return; }
    let n = scene.primitives;
    let p = 9u * i;
    let s1 = exp(primitives[p + 2u]);
    let s2 = exp(primitives[p + 3u]);
    let turn = sin_cos(primitives[p + 4u]);
    let sin = turn.x;
    let cos = turn.y;
    // (u, v) is the offset in the Gaussian's own frame and units, rotated and scaled.
    let sx = sqrt(s1 * s1 * cos * cos + s2 * s2 * sin * sin);
    let f = vec2f(s1 * cos, s2 * sin) / sx;
    let u = moments[i] / HALF;
    let v = moments[n + i] / HALF;
    let uu = moments[2u * n + i] / (HALF * HALF);
    let uv = moments[3u * n + i] / (HALF * HALF);
    let vv = moments[4u * n + i] / (HALF * HALF);
    var gradient = array<f32, 9>(
        f.x * v + f.y * u,
        f.x * u - f.y * v,
        f.x * f.x * vv + 2.0 * f.x * f.y * uv + f.y * f.y * uu,
        f.x * f.x * uu - 2.0 * f.x * f.y * uv + f.y * f.y * vv,
        (f.x * f.y * (uu - vv) + (f.x * f.x - f.y * f.y) * uv) * (s1 / s2 - s2 / s1),
        moments[5u * n + i],
        moments[6u * n + i],
        moments[7u * n + i],
        moments[8u * n + i],
    );
    gradient[2] += scene.price * s1 * s2;
    gradient[3] += scene.price * s1 * s2;
    var move_by = array<f32, 9>();
    for (var k = 0u; k < 9u; k++) {
        var g = gradient[k];
        // Replaces infinities and NaN.
        if (!(abs(g) < 3.0e38)) { g = 0.0; }
        let m = scene.decay.x * first[p + k] + (1.0 - scene.decay.x) * g;
        let s = scene.decay.y * second[p + k] + (1.0 - scene.decay.y) * g * g;
        first[p + k] = m;
        second[p + k] = s;
        move_by[k] = -(m / scene.correction_first) / (sqrt(s / scene.correction_second) + 1e-15);
    }
    for (var k = 5u; k < 9u; k++) {
        primitives[p + k] = clamp(primitives[p + k] + scene.rates.w * move_by[k], -4.0, 4.0);
    }
    let along = scene.rates.x * move_by[0] * s1;
    let across = scene.rates.x * move_by[1] * s2;
    let x = primitives[p] + (cos * along - sin * across);
    let y = primitives[p + 1u] + (sin * along + cos * across);
    primitives[p] = clamp(x, 0.0, scene.size.x);
    primitives[p + 1u] = clamp(y, 0.0, scene.size.y);
    var a = clamp(primitives[p + 2u] + scene.rates.y * move_by[2], scene.min_log_scale, scene.max_log_scale);
    var b = clamp(primitives[p + 3u] + scene.rates.y * move_by[3], scene.min_log_scale, scene.max_log_scale);
    if (a < b) { a = max(a, b - scene.max_log_aspect); } else { b = max(b, a - scene.max_log_aspect); }
    primitives[p + 2u] = a;
    primitives[p + 3u] = b;
    primitives[p + 4u] += scene.rates.z * move_by[4];
    if (i == 0u) { status[2] += 1u; }
}
