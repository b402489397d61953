//! Codes which cells of a tile the layer covers (spec §12.4).

use super::covered::CELL;
use crate::bitstream::broken::Broken;
use crate::bitstream::detail::decisions::{Adaptive, Decisions};

/// Codes a mask. `None` stands for a tile that is covered completely.
pub(super) fn code<D: Decisions>(
    decisions: &mut D,
    [width, height]: [usize; 2],
    given: Option<&[bool]>,
) -> Result<Option<Vec<bool>>, Broken> {
    if !decisions.bit(&mut Adaptive::new(4, 0), given.is_some()) {
        return Ok(None);
    }
    let [across, down] = [width, height].map(|side| side.div_ceil(CELL));
    let mut models = [Adaptive::new(128, 0); 4];
    let mut cells = Vec::with_capacity(across * down);
    for i in 0..across * down {
        // Cells outside the tile count as covered.
        let left = i % across == 0 || cells[i - 1];
        let above = i < across || cells[i - across];
        let model = &mut models[usize::from(left) + 2 * usize::from(above)];
        cells.push(decisions.bit(model, given.is_some_and(|cells| cells[i])));
    }
    let covered = cells.iter().filter(|&&cell| cell).count();
    if covered == 0 || covered == cells.len() {
        return Err(Broken { field: "covered cells of an exact tile", value: covered as u64 });
    }
    Ok(Some(cells))
}
