// Projects primitives to splats on the grid.

struct Primitive {
    mean_x: f32, mean_y: f32,
    log_scale_x: f32, log_scale_y: f32,
    rotation: f32,
    red: f32, green: f32, blue: f32, alpha: f32,
}

@group(0) @binding(1) var<storage, read> primitives: array<Primitive>;
@group(0) @binding(2) var<storage, read_write> splats: array<Splat>;

@compute @workgroup_size(64)
fn project(@builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u, @builtin(local_invocation_index) local: u32) {
    let i = group_index(group, groups) * 64u + local;
    if (i >= scene.primitives) { return; }
    let p = primitives[i];
    let turn = sin_cos(p.rotation);
    let sin = turn.x;
    let cos = turn.y;
    let s1 = exp(p.log_scale_x);
    let s2 = exp(p.log_scale_y);
    let v1 = s1 * s1;
    let v2 = s2 * s2;
    let tx = 1.0 / scene.step.x;
    let ty = 1.0 / scene.step.y;
    let wide = v1 * cos * cos + v2 * sin * sin;
    let tall = v1 * sin * sin + v2 * cos * cos;
    // Square root of the covariance's determinant. √(xx·yy − xy²) would cancel for very narrow Gaussians.
    var root = s1 * s2;
    var amplitude = 1.0;
    let add = scene.widening;
    if (add.x > 0.0 || add.y > 0.0) {
        root = sqrt(v1 * v2 + add.x * tall + add.y * wide + add.x * add.y);
        amplitude = s1 * s2 / root;
    }
    let xx = (wide + add.x) * tx * tx;
    let yy = (tall + add.y) * ty * ty;
    let xy = (v1 - v2) * sin * cos * tx * ty;
    let det = root * tx * ty;
    let sx = sqrt(xx);
    let sy = sqrt(yy);
    let center_x = ((p.mean_x - scene.origin_high.x) - scene.origin_low.x) / scene.step.x - 0.5;
    let center_y = ((p.mean_y - scene.origin_high.y) - scene.origin_low.y) / scene.step.y - 0.5;
    let rise = HALF * sx / det;
    var splat: Splat;
    splat.place = vec4f(center_x, center_y, rise, rise * (xy / xx));
    splat.shape = vec4f(HALF / sx, xy / yy, CUTOFF * det / sy, CUTOFF * xy / sx);
    splat.extent = vec4f(CUTOFF * sx, CUTOFF * sy, amplitude, 0.0);
    splat.color = vec4f(p.red, p.green, p.blue, p.alpha);
    splats[i] = splat;
}
