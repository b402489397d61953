//! A widget of egui that shows a `.ssplat` picture with pan and zoom.
//!
//! A thread renders the part of the picture that is visible, at the size at which it is visible, and a texture of egui
//! holds it. The texture has a margin and is used again until the view leaves it or zooms to another power of two; until
//! the next one arrives, the old one is stretched.

use std::sync::mpsc::{Receiver, Sender, channel};

use egui::{Color32, ColorImage, Context, Pos2, Sense, TextureHandle, TextureOptions, Ui, Vec2};
use ssplat::{Channels, Reader, SamplesMut, SsplatImage};

pub mod view;

use view::{Camera, Part};

/// Margin of a texture, as a fraction of the screen on each side.
const MARGIN: f64 = 0.25;

/// Shows one picture.
pub struct Viewer {
    picture: [u32; 2],
    camera: Option<Camera>,
    ask: Sender<Part>,
    answers: Receiver<(Part, Result<ColorImage, String>)>,
    asked: Option<Part>,
    shown: Option<(Part, TextureHandle)>,
    error: Option<String>,
}

impl Viewer {
    /// Reads the picture and starts the thread that renders it, which ends with the viewer.
    ///
    /// # Errors
    /// As [`Reader::read`].
    pub fn new(reader: &Reader<'_>, ctx: &Context) -> ssplat::Result<Self> {
        let picture = Picture { image: reader.read()?, channels: reader.channels() };
        let size = [reader.width(), reader.height()];
        let (ask, asked) = channel::<Part>();
        let (answer, answers) = channel();
        let ctx = ctx.clone();
        std::thread::spawn(move || {
            while let Ok(mut part) = asked.recv() {
                // Only the newest request counts.
                while let Ok(newer) = asked.try_recv() {
                    part = newer;
                }
                let pixels = picture.render(part).map_err(|e| e.to_string());
                if answer.send((part, pixels)).is_err() {
                    break;
                }
                ctx.request_repaint();
            }
        });
        Ok(Viewer { picture: size, camera: None, ask, answers, asked: None, shown: None, error: None })
    }

    /// Fills the rest of `ui` with the picture.
    pub fn ui(&mut self, ui: &mut Ui) {
        let (place, response) = ui.allocate_exact_size(ui.available_size(), Sense::drag());
        let scale = ui.ctx().pixels_per_point();
        let pixels = |v: Vec2| [f64::from(v.x * scale), f64::from(v.y * scale)];
        let (picture, screen) = (self.picture, pixels(place.size()));
        let camera = self.camera.get_or_insert_with(|| Camera::whole(picture, screen));
        camera.pan(picture, pixels(response.drag_delta()));
        if let Some(pointer) = response.hover_pos() {
            let factor = ui.input(|input| input.zoom_delta() * (input.smooth_scroll_delta.y / 200.0).exp());
            camera.zoom(picture, f64::from(factor), pixels(pointer - place.center()));
        }

        while let Ok((part, answer)) = self.answers.try_recv() {
            match answer {
                Ok(image) => {
                    self.shown = Some((part, ui.ctx().load_texture("ssplat", image, TextureOptions::LINEAR)));
                    self.error = None;
                }
                Err(error) => self.error = Some(error),
            }
        }
        if let Some(needed) = Part::visible(picture, camera, screen, 0.0)
            && !self.asked.is_some_and(|asked| asked.shows(&needed))
        {
            self.asked = Part::visible(picture, camera, screen, MARGIN);
            // The thread is there as long as this viewer is, unless it panicked.
            if let Some(part) = self.asked {
                self.ask.send(part).ok();
            }
        }

        let painter = ui.painter().with_clip_rect(place);
        if let Some((part, texture)) = &self.shown {
            let [left, top, right, bottom] = part.on_screen(camera).map(|at| at as f32 / scale);
            let at = place.center().to_vec2();
            let corners = egui::Rect::from_min_max(Pos2::new(left, top) + at, Pos2::new(right, bottom) + at);
            let whole = egui::Rect::from_min_max(Pos2::ZERO, Pos2::new(1.0, 1.0));
            painter.image(texture.id(), corners, whole, Color32::WHITE);
        }
        if let Some(error) = &self.error {
            ui.put(place, egui::Label::new(error));
        }
    }
}

/// A picture that has been read.
struct Picture {
    image: SsplatImage,
    channels: Channels,
}

impl Picture {
    /// Renders a part with 8 bits per sample.
    fn render(&self, part: Part) -> ssplat::Result<ColorImage> {
        let [width, height] = part.size();
        let view = self.image.view().crop(part.region)?.resized(width, height)?;
        let mut samples = vec![0; width as usize * height as usize * self.channels.count()];
        self.image.render_into(&view, SamplesMut::U8(&mut samples))?;
        Ok(texels([width as usize, height as usize], self.channels, &samples))
    }
}

/// Converts samples, whose alpha is straight, to the colours of egui, which are premultiplied.
fn texels(size: [usize; 2], channels: Channels, samples: &[u8]) -> ColorImage {
    let texel = |sample: &[u8]| match *sample {
        [grey] => Color32::from_gray(grey),
        [grey, alpha] => Color32::from_rgba_unmultiplied(grey, grey, grey, alpha),
        [red, green, blue] => Color32::from_rgb(red, green, blue),
        [red, green, blue, alpha] => Color32::from_rgba_unmultiplied(red, green, blue, alpha),
        _ => unreachable!("a picture has 1 to 4 channels"),
    };
    ColorImage::new(size, samples.chunks_exact(channels.count()).map(texel).collect())
}

#[cfg(test)]
mod tests;
