//! Stiff and extreme cases: each picture is finite, near its definition, and no worse than one constant colour.
//!
//! `cargo test --release --test stability -- --nocapture` prints the table. The report shows the same rows.

#[path = "../src/bin/ssplat/report/scenes.rs"]
#[allow(dead_code)]
mod scenes;
#[path = "../src/bin/ssplat/report/stability.rs"]
#[allow(dead_code)]
mod stability;

#[test]
fn pictures_in_f32_stay_within_a_code_value_of_their_f64_definition() {
    let rows = stability::rendering();
    rows.iter().for_each(|r| println!("{}", r.line()));
    let failed: Vec<_> = rows.iter().filter(|r| !r.holds()).collect();
    assert!(failed.is_empty(), "{failed:#?}");
}

#[test]
fn fits_of_extreme_pictures_are_finite_and_no_worse_than_a_constant_colour() {
    let mut failed = Vec::new();
    for case in stability::fits() {
        let row = stability::fit(&case).unwrap_or_else(|e| panic!("{}: {e}", case.name));
        println!("{}", row.line());
        if !row.holds() {
            failed.push(row);
        }
    }
    assert!(failed.is_empty(), "{failed:#?}");
}
