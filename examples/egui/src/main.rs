//! A window that shows a `.ssplat` file: drag to move it, scroll or pinch to zoom.
//!
//! ```text
//! cargo run --release --manifest-path examples/egui/Cargo.toml -- photo.ssplat
//! ```

use std::error::Error;

use eframe::egui::{CentralPanel, Context, Frame};
use ssplat::{Limits, Reader};
use ssplat_egui::Viewer;

struct Window(Viewer);

impl eframe::App for Window {
    fn update(&mut self, ctx: &Context, _: &mut eframe::Frame) {
        CentralPanel::default().frame(Frame::NONE).show(ctx, |ui| self.0.ui(ui));
    }
}

fn main() -> Result<(), Box<dyn Error>> {
    let path = std::env::args_os().nth(1).ok_or("usage: ssplat-egui FILE")?;
    let reader = Reader::open(&path, &Limits::default())?;
    let title = path.to_string_lossy().into_owned();
    eframe::run_native(
        &title,
        eframe::NativeOptions::default(),
        Box::new(move |creation| Ok(Box::new(Window(Viewer::new(&reader, &creation.egui_ctx)?)))),
    )?;
    Ok(())
}
