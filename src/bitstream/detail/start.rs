//! Initial states of a tile's models: the table of the specification (spec §11.3), which `learn.rs` writes.

/// Number of models in the table.
const COUNT: usize = 3792;

/// All numbers of the table, converted when the library is built.
const TABLE: [[u8; COUNT]; 2] = {
    let text = include_bytes!("../../../spec/detail-models.txt");
    let (mut table, mut count, mut number, mut has_digits) = ([[0; COUNT]; 2], 0, 0, false);
    let mut i = 0;
    while i < text.len() {
        if text[i].is_ascii_digit() {
            (number, has_digits) = (10 * number + (text[i] - b'0'), true);
        } else if has_digits {
            table[count / COUNT][count % COUNT] = number;
            (count, number, has_digits) = (count + 1, 0, false);
        }
        i += 1;
    }
    assert!(count == 2 * COUNT && !has_digits, "the table has another length");
    table
};

/// Probabilities of a 1, in 1/256.
pub(super) static ONE: [u8; COUNT] = TABLE[0];
/// Decisions that each of them counts as.
pub(super) static SEEN: [u8; COUNT] = TABLE[1];
