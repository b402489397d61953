//! A file of a quality that is asked for: the size is found by trying, and what is too good is taken out.

use super::search::{Aim, Curve, Search, Try};
use crate::bitstream::{self, splats::PackedSplats};
use crate::encode::channels::widen;
use crate::encode::file;
use crate::encode::input::stored_scene;
use crate::encode::job::{EncodeSession, Outcome};
use crate::encode::skipped::SkipReason;
use crate::error::{Error, Result};
use crate::fit::model::drawing::field::{Field, Output};
use crate::fit::model::objective::rows::RowSet;
use crate::fit::model::placing::removal;
use crate::fit::model::problem::Problem;
use crate::limits::Limits;
use crate::raster::View;
use crate::round::rounded::projected;
use crate::round::size::Size;
use crate::ssimulacra2::{MIN_SIDE, ssimulacra2};
use crate::strict_math::StrictMath;

/// Most tries. Later ones mostly keep the Gaussians of the ones before.
const MAX_TRIES: usize = 6;
/// Parts of a budget of time: one for each of three tries, and one for taking out what is too good.
const TIMED_PARTS: u32 = 4;
/// Points by which a file may miss what is asked for.
const TOLERANCE: f64 = 0.5;
/// Points above it that a try aims at: what is better can be made worse without another fit, not the other way round.
const AIM_ABOVE: f64 = 0.25;
/// A try this far above is near enough to be made worse instead of trying again.
const MAX_TRIMMED: f64 = 2.5;
/// Primitives that are taken out one by one where some at a time are too many.
const MAX_SINGLY_REMOVED: usize = 24;
/// The curve that pictures are taken to have until theirs is known: halvings of the raw bytes, and points. Kodak, the means of
/// twelve pictures from 20 on; pictures differ by a shift along the first axis for the most part.
/// `cargo run --release -p ssplat-lab --example rate_distortion -- KODAK` measures it.
const TYPICAL_CURVE: [[f64; 2]; 10] = [
    [0.5, 100.0],
    [1.5, 97.0],
    [2.3, 94.5],
    [3.0, 90.5],
    [3.9, 82.0],
    [4.32, 76.1],
    [5.64, 56.1],
    [6.64, 36.7],
    [7.64, 12.7],
    [8.97, -23.9],
];

/// Returns the halvings at which that curve has so many points.
fn halvings(points: f64) -> f64 {
    let next = TYPICAL_CURVE.iter().position(|c| c[1] <= points).unwrap_or(TYPICAL_CURVE.len() - 1).max(1);
    let [[from, high], [to, low]] = [TYPICAL_CURVE[next - 1], TYPICAL_CURVE[next]];
    from + (to - from) * (high - points) / (high - low)
}

/// Points of pictures, which differ from that curve by a shift along the sizes for the most part.
struct Points;

impl Curve for Points {
    fn size(&self, score: f64) -> f64 {
        -halvings(score)
    }

    fn beyond(&self, tried: Try, wanted: f64) -> f64 {
        tried.size + halvings(tried.score) - halvings(wanted)
    }

    fn between(&self, low: Try, high: Try, wanted: f64) -> f64 {
        // A straight line on the curve's own scale.
        let [from, to, at] = [low.score, high.score, wanted].map(|score| -halvings(score));
        low.size + (high.size - low.size) * (at - from) / (to - from)
    }
}

impl EncodeSession<'_> {
    /// Fits the picture for `wanted` points of SSIMULACRA2.
    pub(super) fn at_quality(&mut self, wanted: f64) -> Result<Outcome> {
        let pixels = self.input.original;
        if pixels.width().min(pixels.height()) < MIN_SIDE {
            let problem = format!(
                "SSIMULACRA2 takes no picture of {} × {}: a side has to have {MIN_SIDE} pixels at least",
                pixels.width(),
                pixels.height()
            );
            return Err(Error::Parameter { name: "quality", problem });
        }
        let raw = self.input.samples();
        let carried = self.carried()?;
        let share = self.clock.left().map(|time| time / TIMED_PARTS);
        let aim = Aim {
            enough: wanted - TOLERANCE,
            aim: wanted + AIM_ABOVE,
            sizes: super::sizes_tried(raw),
            tries: MAX_TRIES,
        };
        let mut search = Search::new(Points, aim);
        let mut best: Option<(f64, Outcome)> = None;
        while let Some(size) = search.next() {
            if best.is_some() && self.clock.left() < share {
                break;
            }
            self.share = share;
            let outcome = self.layered(Size::Bytes(carried + (raw * size.strict_exp2()) as u64))?;
            let points = self.points(&outcome.splats)?;
            search.note(size, points);
            let near = if can_be_trimmed(&outcome) { MAX_TRIMMED } else { TOLERANCE };
            if best.as_ref().is_none_or(|(found, _)| is_better(points, *found, wanted)) {
                best = Some((points, outcome));
            }
            if (-TOLERANCE..=near).contains(&(points - wanted)) {
                break;
            }
        }
        let (points, mut outcome) = best.expect("one try at least");
        outcome.quality = Some(points);
        if points > wanted + AIM_ABOVE {
            self.trim_to_quality(&mut outcome, wanted)?;
        }
        outcome.quality = Some(self.points_of_file(&outcome.bytes)?);
        Ok(outcome)
    }

    /// Returns the points of a file with these integers of what was fitted.
    fn points(&self, splats: &PackedSplats) -> Result<f64> {
        let wide = (!self.input.is_whole()).then(|| widen(splats, self.input.channels()));
        self.points_drawn(wide.as_ref().unwrap_or(splats))
    }

    /// Returns the points of a file as a decoder sees it: its Gaussians are in the order of the file, which moves the last bits.
    fn points_of_file(&self, file: &[u8]) -> Result<f64> {
        self.points_drawn(&bitstream::read(file, &own_limits())?)
    }

    fn points_drawn(&self, splats: &PackedSplats) -> Result<f64> {
        let view = View::of_size(splats.width, splats.height);
        let drawn = splats.renderer(&view, &own_limits())?.render(splats.depth)?;
        Ok(ssimulacra2(self.input.original, &drawn)?.expect("the sides were looked at"))
    }

    /// Takes out the primitives that are missed least, as long as `wanted` points are left.
    fn trim_to_quality(&mut self, outcome: &mut Outcome, wanted: f64) -> Result<()> {
        if !can_be_trimmed(outcome) {
            return Ok(());
        }
        let clock = self.report.seconds();
        let splats = &outcome.splats;
        let problem = Problem { scene: stored_scene(splats), target: &self.planes };
        let drawn = projected(&splats.quantizer(), &splats.gaussians, splats.height);
        let mut field = Field::default();
        field.draw(&problem, &drawn, RowSet::ALL, Output::Picture);
        let order = removal::cheapest_first(&removal::costs(&problem, &field, RowSet::ALL, &drawn));
        let without = |out: &[usize]| {
            let mut is_out = vec![false; order.len()];
            out.iter().for_each(|&i| is_out[i] = true);
            let left = splats.gaussians.iter().zip(&is_out).filter(|(_, out)| !**out).map(|(g, _)| *g);
            PackedSplats { gaussians: left.collect(), codebook: None, ..splats.clone() }
        };
        // Between `sure`, without which there are points enough, and `over`, without which there are not.
        let (mut sure, mut over, mut points) = (0, order.len() + 1, outcome.quality);
        // The first guess is small: a point is a part of a hundred or so.
        let mut next = order.len() / 64 + 1;
        let enough = (order.len() / 1000).max(1);
        while over - sure > enough && !self.clock.is_over() {
            let count = next.clamp(sure + 1, over - 1);
            let found = self.points(&without(&order[..count]))?;
            if found >= wanted {
                (sure, points) = (count, Some(found));
                if found - wanted < AIM_ABOVE {
                    break;
                }
            } else {
                over = count;
            }
            next = if over > order.len() { sure * 2 } else { (sure + over) / 2 };
        }
        // Primitives of little squared error can still matter to the eye: try the next ones one by one.
        let mut out = order[..sure].to_vec();
        for &i in order[sure..].iter().take(MAX_SINGLY_REMOVED) {
            if points.is_none_or(|p| p - wanted < AIM_ABOVE) || self.clock.is_over() {
                break;
            }
            out.push(i);
            let found = self.points(&without(&out))?;
            if found >= wanted {
                points = Some(found);
            } else {
                out.pop();
            }
        }
        if !out.is_empty() {
            let mut fewer = without(&out);
            let narrow = file::smallest(&mut fewer, 1)?;
            let bytes = if self.input.is_whole() { narrow } else { self.input.file(&fewer)? };
            if bytes.len() < outcome.bytes.len() {
                self.report.note(SkipReason::Primitives, (outcome.bytes.len() - bytes.len()) as u64, 0.0);
                (outcome.bytes, outcome.splats, outcome.quality) = (bytes, fewer, points);
            }
        }
        self.report.stage("prune", clock);
        Ok(())
    }
}

/// The encoder's own integers need no limits on work.
fn own_limits() -> Limits {
    Limits { tile_pairs: u64::MAX, work: u64::MAX, overlap: u64::MAX, primitives: u64::MAX, ..Limits::default() }
}

/// Tells whether primitives can be taken out of a file one by one: their value is not known for files with levels or a detail layer.
fn can_be_trimmed(outcome: &Outcome) -> bool {
    outcome.splats.levels.is_empty() && outcome.splats.detail.is_none()
}

/// Tells whether a file of `points` is more of what is wanted than one that has `found`: of two that are good enough the worse
/// one, which is the smaller; else the better one.
fn is_better(points: f64, found: f64, wanted: f64) -> bool {
    let is_enough = |points: f64| points >= wanted - TOLERANCE;
    match (is_enough(points), is_enough(found)) {
        (true, true) => points < found,
        (true, false) => true,
        (false, true) => false,
        (false, false) => points > found,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_curve_falls_and_is_met_at_its_knots() {
        assert!(TYPICAL_CURVE.windows(2).all(|c| c[0][0] < c[1][0] && c[0][1] > c[1][1]));
        for [at, points] in TYPICAL_CURVE {
            assert!((halvings(points) - at).abs() < 1e-9, "{points}");
        }
        let all: Vec<f64> = (0..=100).map(|q| halvings(f64::from(q))).collect();
        assert!(all.is_sorted_by(|a, b| a > b) && all[100] < 1.0 && all[0] < 9.0, "{all:?}");
    }

    #[test]
    fn two_tries_find_a_picture_whose_curve_is_another() {
        // kodim15 at effort 3: halvings of the raw bytes, and points.
        let known = [[3.0, 87.97], [3.907, 80.33], [4.907, 69.39], [5.907, 58.49], [6.907, 44.26], [7.907, 26.3]];
        let measured = |at: f64| {
            let next = known.iter().position(|k| k[0] >= at).unwrap_or(known.len() - 1).max(1);
            let [[a, p], [b, q]] = [known[next - 1], known[next]];
            p + (q - p) * (at - a) / (b - a)
        };
        for wanted in [30.0, 50.0, 70.0, 85.0] {
            let aim = Aim { enough: wanted - TOLERANCE, aim: wanted, sizes: [-9.0, 0.0], tries: MAX_TRIES };
            let mut search = Search::new(Points, aim);
            let (mut tries, mut points) = (0, 0.0);
            while let Some(size) = search.next() {
                points = measured(-size);
                search.note(size, points);
                tries += 1;
                if (points - wanted).abs() < TOLERANCE {
                    break;
                }
            }
            assert!((points - wanted).abs() < TOLERANCE && tries <= 3, "{wanted}: {points} after {tries}");
        }
    }

    #[test]
    fn the_smallest_file_that_is_good_enough_is_taken() {
        assert!(is_better(70.2, 74.0, 70.0) && !is_better(74.0, 70.2, 70.0));
        assert!(is_better(70.2, 69.0, 70.0) && !is_better(69.0, 70.2, 70.0));
        assert!(is_better(69.0, 60.0, 70.0) && !is_better(60.0, 69.0, 70.0));
    }
}
