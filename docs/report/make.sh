#!/bin/sh
# Makes the report in this folder: under ten minutes on two cores, some three of them for building. Started again, it goes on
# where it stopped; `rm -r target/report` makes it begin anew. cjpeg, cwebp, avifenc and cjxl are run where they are installed.
set -e
cd "$(dirname "$0")/../.."
out=target/report
mkdir -p "$out"
# What fits on a GPU takes minutes to build: only where there may be one.
features=
for device in /dev/dri/renderD* /dev/nvidia0 /dev/dxg; do
    if [ -e "$device" ]; then features="--features gpu"; fi
done
if [ "$(uname)" = Darwin ]; then features="--features gpu"; fi
# The stiff cases are tests, inside and outside; the report shows the rows that they print.
# shellcheck disable=SC2086
cargo test -q --release -p ssplat -p ssplat-lab $features --test stability -- --nocapture >"$out/tests.txt"
# shellcheck disable=SC2086
cargo test -q --release -p ssplat -p ssplat-lab $features --lib stability -- --nocapture >>"$out/tests.txt"
# shellcheck disable=SC2086
cargo build -q --release -p ssplat-lab $features
# The steps of SmartSplat see every pixel and its structural similarity: one picture is enough.
"${CARGO_TARGET_DIR:-target}/release/ssplat-lab" report tests/images/kodim15.png tests/images/kodim05.png --out "$out" \
    --ratios 50,200,1000 --efforts 1,3,5 --smartsplat-images 1 --stability "$out/tests.txt"
cp "$out/index.html" "$out/results.csv" "$out/results.json" "$out/anchors.csv" "$out/tables.md" docs/report/
