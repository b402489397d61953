// Shared by forward, residual and importance: the pixels of the target, and the weights of pixels and channels.

// Red, green, blue and alpha of the target's pixel in column `x` of picture row `y`.
fn source_pixel(x: u32, y: u32) -> vec4f {
    let at = ((y - scene.source_first) * scene.width + x) * scene.source_words;
    if (scene.source_words - scene.weighted == 1u) { return unpack4x8unorm(source[at]); }
    return vec4f(unpack2x16unorm(source[at]), unpack2x16unorm(source[at + 1u]));
}

// Returns the factor of the error at a pixel before it is squared.
fn amplitude(x: u32, y: u32) -> f32 {
    if (scene.weighted == 0u) { return 1.0; }
    return bitcast<f32>(source[((y - scene.source_first) * scene.width + x + 1u) * scene.source_words - 1u]);
}

// Returns the factor of the error in each channel before it is squared, without that of the tuning: the square root of
// the opacity, or 0 for unused channels.
fn importance_of_channels(wanted: vec4f) -> vec4f {
    var opacity = 1.0;
    if (scene.alpha == 1u) { opacity = wanted.y; }
    if (scene.alpha == 3u) { opacity = wanted.w; }
    var share = vec4f(sqrt(opacity));
    if (scene.alpha == 1u) { share.y = 1.0; }
    if (scene.alpha == 3u) { share.w = 1.0; }
    return select(vec4f(0.0), share, vec4u(0u, 1u, 2u, 3u) < vec4u(scene.channels));
}
