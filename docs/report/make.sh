#!/bin/sh
# Makes the report in this folder: a quarter of an hour on two cores. Started again, it goes on where it stopped;
# `rm -r target/report` makes it begin anew. cjpeg, cwebp, avifenc and cjxl are run where they are installed.
set -e
cd "$(dirname "$0")/../.."
out=target/report
mkdir -p "$out"
# The cases that need the encoder's inside are tests; their rows join those that the program measures itself.
cargo test -q --release --features cli --lib stability -- --nocapture >"$out/tests.txt"
cargo run -q --release --features cli -- report tests/images/kodim05.png tests/images/kodim15.png \
    --out "$out" --ratios 50,200,1000 --efforts 1,3,5 --stability "$out/tests.txt"
cp "$out/index.html" "$out/results.csv" "$out/results.json" "$out/anchors.csv" "$out/tables.md" docs/report/
