//! SSIMULACRA2 for JavaScript: the samples of two pictures in, a score out. `web/encode-machine.js` is the other side.
//!
//! It is a module of its own because most encodes do not need it. No pointer is followed here.

use std::cell::RefCell;

use ssplat::unstable::metrics;
use ssplat::{Channels, Pixels, Samples};

thread_local! {
    /// Samples of the reference and of the picture to compare with it.
    static INPUTS: RefCell<[Vec<u8>; 2]> = RefCell::default();
}

/// Makes room for `length` bytes of input `which`, and returns where they go; 0 if there is no room.
#[unsafe(no_mangle)]
pub extern "C" fn input(which: usize, length: usize) -> *mut u8 {
    INPUTS.with_borrow_mut(|inputs| {
        let Some(input) = inputs.get_mut(which) else { return std::ptr::null_mut() };
        *input = Vec::new();
        if input.try_reserve_exact(length).is_err() {
            return std::ptr::null_mut();
        }
        input.resize(length, 0);
        input.as_mut_ptr()
    })
}

/// Returns the score of input 1 against input 0: rows from the top, channels interleaved, 16 bits little-endian. Returns NaN
/// if a side has fewer than 8 pixels. Stops the module if the inputs do not have that size.
#[unsafe(no_mangle)]
pub extern "C" fn ssimulacra2(width: u32, height: u32, channels: usize, bits: u32) -> f64 {
    let channels = Channels::from_count(channels).expect("1 to 4 channels");
    let [reference, test] = INPUTS.take().map(|bytes| {
        let samples = match bits {
            8 => Samples::U8(bytes),
            _ => Samples::U16(bytes.chunks_exact(2).map(|pair| u16::from_le_bytes([pair[0], pair[1]])).collect()),
        };
        Pixels::new(width, height, channels, samples).expect("samples of the whole picture")
    });
    metrics::ssimulacra2(&reference, &test).expect("two pictures of the same kind")
}
