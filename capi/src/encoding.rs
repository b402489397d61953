//! An encoder's options, and encoding on threads of its own; safe code only.

use std::ops::ControlFlow;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::channel;
use std::time::Duration;

use rayon::ThreadPoolBuilder;
use ssplat::{Cicp, Detail, EncodeReport, Encoded, Encoder, Error, HiddenColors, Pixels, Target, Thumbnail, Tune};

use crate::failure::{Failure, Outcome, ssplat_status};

/// Most threads of an encode.
const MOST_THREADS: i64 = 256;

/// Takes the name of a stage and the share of it that is done; whether to go on.
pub type Watch<'a> = &'a mut dyn FnMut(&str, f32) -> bool;

/// Targets of an encode, for ssplat_encoder_set_target(). The last one that is set counts.
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub enum ssplat_target {
    /// Perceptual quality: the SSIMULACRA2 score, 0 to 100; 30 is low, 50 medium, 70 high and 90 very high. The default
    /// is 70.
    Quality = 0,
    /// Width * height * channels of the picture, divided by the bytes of the file.
    Ratio = 1,
    /// Most bytes of the file.
    Bytes = 2,
    /// PSNR in dB.
    Psnr = 3,
    /// The samples of the picture themselves; the value is ignored. Colours under alpha 0 become black unless
    /// SSPLAT_OPTION_KEEP_HIDDEN is set.
    Lossless = 4,
    /// Number of Gaussians, without a detail layer.
    Gaussians = 5,
}

/// Measures that the encoder optimizes, for SSPLAT_OPTION_TUNE.
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub enum ssplat_tune {
    /// SSPLAT_TUNE_IQ, or SSPLAT_TUNE_PSNR if the target is a PSNR.
    Auto = 0,
    /// Perceived quality from some distance.
    Iq = 1,
    /// Squared error.
    Psnr = 2,
}

/// Options of an encoder, for ssplat_encoder_set_option().
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub enum ssplat_option {
    /// Amount of work, 1 to 9; the default is 5. Each step takes up to twice as long as the one before.
    Effort = 0,
    /// Threads, 1 to 256; 0, the default, is one per core. The file does not depend on it.
    Threads = 1,
    /// Most milliseconds of the encode; 0, the default, sets no limit. If the time is short for the effort, the effort
    /// is lowered.
    Milliseconds = 2,
    /// 1 keeps the colours of pixels of alpha 0; 0, the default, replaces them, because no viewer shows them.
    KeepHidden = 3,
    /// A value of ssplat_tune.
    Tune = 4,
    /// 0 leaves out the detail layer, so that the file has Gaussians alone; the default is 1.
    Detail = 5,
    /// Progressive levels, 1 to 8; the default is 1. A file that is cut off after a level shows a coarser picture.
    Levels = 6,
    /// Most bytes of a thumbnail in the file: 0 for none, -1, the default, for one of at most 4000 bytes in files of at
    /// least 100 000 bytes.
    Thumbnail = 7,
    /// Side of the tiles in which the picture is fitted, in pixels: a multiple of 128 up to 16384. 0, the default, is
    /// tiles of 2048 for pictures of more than 33 megapixels.
    Tiles = 8,
    /// Seed of the random numbers; the default is 0. Equal seeds give equal bytes.
    Seed = 9,
}

/// Everything that an encoder holds.
#[derive(Default)]
pub struct Encoding {
    encoder: Encoder,
    /// Options that, once set, have no way back to their default in [`Encoder`].
    time: Option<Duration>,
    tune: Option<Tune>,
    tiles: Option<u32>,
    cicp: Option<Cicp>,
    icc: Option<Vec<u8>>,
    exif: Option<Vec<u8>>,
    /// 0 is one per core.
    threads: usize,
    /// Bytes and report of the last encode.
    last: Option<(u64, EncodeReport)>,
}

impl Encoding {
    /// Drops what the last encode has left.
    pub fn abandon(&mut self) {
        self.last = None;
    }

    pub fn set_target(&mut self, target: i32, value: f64) -> Outcome<()> {
        let target = match target {
            0 => Target::Quality(value),
            1 => Target::Ratio(value),
            2 => Target::Bytes(whole("bytes", value)?),
            3 => Target::Psnr(value),
            4 => Target::Lossless,
            5 => Target::Gaussians(whole("gaussians", value)?.try_into().unwrap_or(u32::MAX)),
            _ => return Err(Failure::parameter(format_args!("there is no target {target}"))),
        };
        self.change(|encoder| encoder.target(target));
        Ok(())
    }

    pub fn set_option(&mut self, option: i32, value: i64) -> Outcome<()> {
        let within = |name: &str, least: i64, most: i64| match value {
            v if (least..=most).contains(&v) => Ok(v),
            v => Err(Failure::parameter(format_args!("{name} is {v}, outside {least} to {most}"))),
        };
        match option {
            0 => {
                let effort = within("effort", 1, 9)? as u8;
                self.change(|encoder| encoder.effort(effort));
            }
            1 => self.threads = within("threads", 0, MOST_THREADS)? as usize,
            2 => {
                let limit = within("milliseconds", 0, i64::MAX)? as u64;
                self.time = (limit > 0).then(|| Duration::from_millis(limit));
            }
            3 => {
                let is_kept = within("keep hidden", 0, 1)? == 1;
                let hidden = if is_kept { HiddenColors::Keep } else { HiddenColors::Continue };
                self.change(|encoder| encoder.hidden_colors(hidden));
            }
            4 => self.tune = [None, Some(Tune::Iq), Some(Tune::Psnr)][within("tune", 0, 2)? as usize],
            5 => {
                let detail = if within("detail", 0, 1)? == 1 { Detail::Auto } else { Detail::Off };
                self.change(|encoder| encoder.detail(detail));
            }
            6 => {
                let levels = within("levels", 1, 8)? as u8;
                self.change(|encoder| encoder.levels(levels));
            }
            7 => {
                let thumbnail = match within("thumbnail", -1, u32::MAX.into())? {
                    -1 => Thumbnail::Auto,
                    0 => Thumbnail::Never,
                    bytes => Thumbnail::Bytes(bytes as u32),
                };
                self.change(|encoder| encoder.thumbnail(thumbnail));
            }
            8 => {
                let side = within("tiles", 0, u32::MAX.into())? as u32;
                self.tiles = (side > 0).then_some(side);
            }
            9 => {
                let seed = within("seed", 0, i64::MAX)? as u64;
                self.change(|encoder| encoder.seed(seed));
            }
            _ => return Err(Failure::parameter(format_args!("there is no option {option}"))),
        }
        Ok(())
    }

    /// Sets the code points, the ICC profile or the EXIF block of the files; no bytes take it away.
    pub fn set_metadata(&mut self, which: i32, bytes: &[u8]) -> Outcome<()> {
        let slot = match which {
            0 => &mut self.icc,
            1 => &mut self.exif,
            3 => {
                let parsed = if bytes.is_empty() { None } else { Some(Cicp::from_bytes(bytes)) };
                self.cicp = parsed.transpose().map_err(Failure::parameter)?;
                return Ok(());
            }
            _ => return Err(Failure::parameter(format_args!("the encoder stores no metadata {which}"))),
        };
        *slot = None;
        if !bytes.is_empty() {
            let mut copy = Vec::new();
            copy.try_reserve_exact(bytes.len()).map_err(|e| Failure::new(ssplat_status::Memory, e))?;
            copy.extend_from_slice(bytes);
            *slot = Some(copy);
        }
        Ok(())
    }

    fn change(&mut self, set: impl FnOnce(Encoder) -> Encoder) {
        self.encoder = set(std::mem::take(&mut self.encoder));
    }

    /// The encoder with all options.
    fn complete(&self) -> Encoder {
        let mut encoder = self.encoder.clone();
        if let Some(time) = self.time {
            encoder = encoder.time(time);
        }
        if let Some(tune) = self.tune {
            encoder = encoder.tune(tune);
        }
        if let Some(side) = self.tiles {
            encoder = encoder.tiles(side);
        }
        if let Some(cicp) = self.cicp {
            encoder = encoder.cicp(cicp);
        }
        if let Some(icc) = &self.icc {
            encoder = encoder.icc(icc.clone());
        }
        if let Some(exif) = &self.exif {
            encoder = encoder.exif(exif.clone());
        }
        encoder
    }

    /// The file of `pixels`. `watch` is called in this thread.
    pub fn encode(&mut self, pixels: &Pixels, watch: Watch<'_>) -> Outcome<Vec<u8>> {
        self.last = None;
        let pool = ThreadPoolBuilder::new().num_threads(self.threads).build();
        let pool = pool.map_err(|e| Failure::new(ssplat_status::Memory, e))?;
        let (encoder, is_stopped, (sender, steps)) = (self.complete(), AtomicBool::new(false), channel());
        let is_stopped = &is_stopped;
        let Encoded { bytes, report, .. } = std::thread::scope(|scope| {
            let work = scope.spawn(|| {
                pool.install(move || {
                    encoder.encode_with_progress(pixels, &mut |progress| {
                        // The receiver lives until the sender is gone.
                        let _ = sender.send((progress.stage, progress.done));
                        if is_stopped.load(Ordering::Relaxed) {
                            return ControlFlow::Break(());
                        }
                        ControlFlow::Continue(())
                    })
                })
            });
            for (stage, done) in steps {
                // After the first refusal the callback is left in peace.
                if !is_stopped.load(Ordering::Relaxed) && !watch(stage, done) {
                    is_stopped.store(true, Ordering::Relaxed);
                }
            }
            // A panic goes on in this thread, where the caller of this function stops it.
            work.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic))
        })?;
        if is_stopped.load(Ordering::Relaxed) {
            return Err(Error::Cancelled.into());
        }
        self.last = Some((bytes.len() as u64, report));
        Ok(bytes)
    }

    /// Bytes and report of the last encode.
    pub fn last(&self) -> Outcome<&(u64, EncodeReport)> {
        self.last.as_ref().ok_or_else(|| Failure::new(ssplat_status::Closed, "nothing has been encoded"))
    }
}

/// The whole number that a caller has put into a double.
fn whole(name: &str, value: f64) -> Outcome<u64> {
    // Doubles above 2⁵³ are whole.
    if (0.0..18e18).contains(&value) && value.fract() == 0.0 {
        return Ok(value as u64);
    }
    Err(Failure::parameter(format_args!("{name} is {value}, which is no whole number from 0 on")))
}
