//! The properties of a picture in a line of text: `size=768x512;blend=normalized;…`, in the comments of tables and
//! point files.

use std::fmt::Write;

use ssplat::unstable::bitstream::splats::{Layout, Steps};
use ssplat::{Blend, Channels, Depth, Gaussian, Gaussians};

use super::parameters::{self, Given, Parameters};
use super::problem::{Problem, shown};
use crate::names;

/// Start of the line.
pub const START: &str = "ssplat ";

/// What such a line states.
#[derive(Debug, Clone, Default)]
pub struct Stated {
    size: Option<[u32; 2]>,
    blend: Option<Blend>,
    depth: Option<Depth>,
    layout: Option<Layout>,
    steps: Option<Steps>,
    background: Vec<f64>,
}

/// Returns the line without its start.
pub fn line(of: &Parameters) -> String {
    let p = &of.picture;
    let background: Vec<String> = p.background[..p.channels.count()].iter().map(f32::to_string).collect();
    let (blend, depth) = (names::blend_name(p.blend), 8 * p.depth.bytes());
    let mut out =
        format!("size={}x{};blend={blend};background={};depth={depth}", p.width, p.height, background.join(" "));
    if let Some((layout, steps)) = of.stored {
        let steps = parameters::numbers_of(&steps).map(|v| v.to_string()).join(" ");
        let _ = write!(out, ";layout={};steps={steps}", names::layout_name(layout));
    }
    out
}

impl Stated {
    /// Takes the properties of a line; unknown ones are ignored.
    pub fn add(&mut self, line: &str) -> Result<(), Problem> {
        for (name, value) in line.split(';').filter_map(|s| s.split_once('=')) {
            match name.trim() {
                "size" => self.size = Some(parameters::size(value)?),
                "blend" => self.blend = Some(parameters::blend_of(value)?),
                "background" => self.background = floats(value)?,
                "depth" => {
                    let bits = value.parse().map_err(|_| format!("depth is {}", shown(value)))?;
                    self.depth = Some(parameters::depth_of(bits)?);
                }
                "layout" => self.layout = Some(parameters::layout_of(value)?),
                "steps" => self.steps = Some(parameters::steps_of(&floats(value)?)?),
                _ => {}
            }
        }
        Ok(())
    }

    /// Returns the number of channels of the background, if it is stated.
    pub fn background(&self) -> Option<usize> {
        (!self.background.is_empty()).then_some(self.background.len())
    }

    /// Returns the parameters of these Gaussians, which are those of `whose`, with a verb for messages.
    pub fn parameters(
        self,
        list: Vec<Gaussian>,
        channels: Channels,
        given: Given,
        whose: &str,
    ) -> Result<Parameters, Problem> {
        if let Some(count) = self.background().filter(|&count| count != channels.count()) {
            return Err(format!("the background has {count} channels, {whose} {}", channels.count()).into());
        }
        let mut background = [0.0; 4];
        self.background.iter().zip(&mut background).for_each(|(v, c)| *c = *v as f32);
        let [width, height] = given.size(self.size)?;
        let (blend, depth) = (given.blend(self.blend)?, self.depth.unwrap_or(Depth::Eight));
        let picture = Gaussians { width, height, channels, depth, blend, background, list };
        Ok(Parameters { picture, stored: self.layout.zip(self.steps) })
    }
}

/// Parses a list of finite numbers.
fn floats(text: &str) -> Result<Vec<f64>, String> {
    let number = |v: &str| v.parse().ok().filter(|v: &f64| v.is_finite());
    let one = |v: &str| number(v).ok_or_else(|| format!("'{}' is not a finite number", shown(v)));
    text.split_whitespace().take(parameters::MOST_NUMBERS).map(one).collect()
}
