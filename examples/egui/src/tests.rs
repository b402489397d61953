//! The part of the picture that is rendered, its size, the colours of the texture, and frames of egui without a window.

use std::time::{Duration, Instant};

use egui::{Event, ImageData, MouseWheelUnit, RawInput, TextureId, vec2};
use ssplat::Limits;

use super::*;

const PICTURE: [u32; 2] = [1000, 600];
const SCREEN: [f64; 2] = [400.0, 400.0];

fn vector(name: &str) -> Reader<'static> {
    let path = format!("{}/../../spec/vectors/valid/{name}/file.ssplat", env!("CARGO_MANIFEST_DIR"));
    Reader::open(path, &Limits::default()).unwrap()
}

#[test]
fn the_whole_picture_is_asked_for_at_the_next_power_of_two() {
    let camera = Camera::whole(PICTURE, SCREEN);
    assert_eq!(camera, Camera { center: [500.0, 300.0], zoom: 0.4 });
    let part = Part::visible(PICTURE, &camera, SCREEN, MARGIN).unwrap();
    assert_eq!(part, Part { region: ssplat::Rect::new(0, 0, 1000, 600), level: -1 });
    assert_eq!(part.size(), [500, 300]);
    assert_eq!(part.on_screen(&camera), [-200.0, -120.0, 200.0, 120.0]);
}

#[test]
fn only_the_visible_part_is_asked_for() {
    let camera = Camera { center: [100.5, 300.0], zoom: 4.0 };
    let part = Part::visible(PICTURE, &camera, SCREEN, 0.0).unwrap();
    assert_eq!(part, Part { region: ssplat::Rect::new(50, 250, 101, 100), level: 2 });
    assert_eq!(part.size(), [404, 400]);
    // Odd sides are rounded up, so that nothing is cut off.
    assert_eq!(Part { level: -3, ..part }.size(), [13, 13]);
    // Beside the picture.
    let beside = Camera { center: [-300.0, 300.0], zoom: 1.0 };
    assert_eq!(Part::visible(PICTURE, &beside, SCREEN, 0.0), None);
}

#[test]
fn a_texture_is_used_again_within_its_margin_and_up_to_twice_the_size() {
    let mut camera = Camera { center: [500.0, 300.0], zoom: 2.5 };
    let part = Part::visible(PICTURE, &camera, SCREEN, MARGIN).unwrap();
    let shows = |camera: &Camera| part.shows(&Part::visible(PICTURE, camera, SCREEN, 0.0).unwrap());
    assert!(shows(&camera));
    camera.pan(PICTURE, [99.0, -99.0]);
    assert!(shows(&camera));
    camera.pan(PICTURE, [10.0, 0.0]);
    assert!(!shows(&camera), "beyond the margin");
    let zoomed = |zoom| Camera { center: [500.0, 300.0], zoom };
    assert!(shows(&zoomed(4.0)));
    assert!(!shows(&zoomed(4.1)), "too coarse");
    assert!(!shows(&zoomed(2.0)), "finer than needed");
}

#[test]
fn the_point_under_the_pointer_stays_there() {
    let mut camera = Camera { center: [500.0, 300.0], zoom: 0.5 };
    let at = [120.0, -40.0];
    let point = |camera: &Camera| [0, 1].map(|axis| camera.center[axis] + at[axis] / camera.zoom);
    let before = point(&camera);
    camera.zoom(PICTURE, 3.0, at);
    assert_eq!(camera.zoom, 1.5);
    // Rounding of a few operations on numbers below 1024.
    assert!(before.iter().zip(point(&camera)).all(|(a, b)| (a - b).abs() < 1e-9));
}

#[test]
fn alpha_is_premultiplied() {
    let image = texels([2, 1], Channels::Rgba, &[200, 100, 50, 128, 9, 9, 9, 0]);
    assert_eq!(image.pixels, [Color32::from_rgba_unmultiplied(200, 100, 50, 128), Color32::TRANSPARENT]);
    let [red, green, blue, alpha] = image.pixels[0].to_array();
    // Rounded to the nearest, or down.
    assert!(
        [(red, 200), (green, 100), (blue, 50)]
            .iter()
            .all(|&(got, c)| (f64::from(got) - f64::from(c) * 128.0 / 255.0).abs() <= 1.0)
    );
    assert_eq!(alpha, 128);
    assert_eq!(texels([1, 1], Channels::GreyAlpha, &[255, 64]).pixels, [Color32::from_white_alpha(64)]);
    assert_eq!(texels([1, 1], Channels::Rgb, &[1, 2, 3]).pixels, [Color32::from_rgb(1, 2, 3)]);
    assert_eq!(texels([1, 1], Channels::Grey, &[7]).pixels, [Color32::from_gray(7)]);
}

/// Runs frames until a texture arrives, and returns it.
fn next_texture(ctx: &Context, viewer: &mut Viewer, events: &[Event]) -> ColorImage {
    let start = Instant::now();
    let mut events = events.to_vec();
    while start.elapsed() < Duration::from_secs(60) {
        let screen = egui::Rect::from_min_size(Pos2::ZERO, vec2(64.0, 48.0));
        let input = RawInput { screen_rect: Some(screen), events: std::mem::take(&mut events), ..Default::default() };
        let output = ctx.run(input, |ctx| {
            egui::CentralPanel::default().frame(egui::Frame::NONE).show(ctx, |ui| viewer.ui(ui));
        });
        for (id, delta) in output.textures_delta.set {
            // The first texture is that of the font.
            if id != TextureId::default() {
                let ImageData::Color(image) = delta.image;
                return (*image).clone();
            }
        }
        std::thread::sleep(Duration::from_millis(5));
    }
    panic!("no texture: {:?}", viewer.error);
}

#[test]
fn a_window_shows_the_pixels_of_the_decoder_and_finer_ones_when_it_zooms() {
    let reader = vector("detail-rgba");
    let (ctx, size) = (Context::default(), [reader.width() as usize, reader.height() as usize]);
    let mut viewer = Viewer::new(&reader, &ctx).unwrap();
    let image = next_texture(&ctx, &mut viewer, &[]);
    let whole = reader.read().unwrap();
    let mut samples = vec![0; 4 * size[0] * size[1]];
    whole.render_into(&whole.view(), SamplesMut::U8(&mut samples)).unwrap();
    assert_eq!(image.size, size);
    assert!(image.pixels == texels(size, Channels::Rgba, &samples).pixels);
    // The mouse wheel over the middle, which egui spreads over several frames.
    let scroll =
        Event::MouseWheel { unit: MouseWheelUnit::Point, delta: vec2(0.0, 200.0), modifiers: Default::default() };
    let finer = next_texture(&ctx, &mut viewer, &[Event::PointerMoved(Pos2::new(32.0, 24.0)), scroll]);
    let level = viewer.shown.as_ref().unwrap().0.level;
    assert!(level > 0 && finer.size[0] > size[0], "{level}, {:?}", finer.size);
}
