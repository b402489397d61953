#!/bin/sh
# Makes the report in this folder. It takes less than ten minutes on two idle cores, about three of them for building. An
# interrupted run can be continued; `rm -r target/report` discards earlier results. cjpeg, cwebp, avifenc and cjxl are used if
# they are installed.
set -e
cd "$(dirname "$0")/../.."
out=target/report
mkdir -p "$out"
# GPU support takes minutes to build, so it is built only if the machine may have a GPU.
features=
for device in /dev/dri/renderD* /dev/nvidia0 /dev/dxg; do
    if [ -e "$device" ]; then features="--features gpu"; fi
done
if [ "$(uname)" = Darwin ]; then features="--features gpu"; fi
# The stiff cases are integration tests and unit tests. The report shows the rows that they print.
# shellcheck disable=SC2086
cargo test -q --release -p ssplat -p ssplat-lab $features --test writing stability -- --nocapture >"$out/tests.txt"
# shellcheck disable=SC2086
cargo test -q --release -p ssplat -p ssplat-lab $features --lib stability -- --nocapture >>"$out/tests.txt"
# shellcheck disable=SC2086
cargo build -q --release -p ssplat-lab $features
# Each step of SmartSplat visits every pixel and computes SSIM, so it runs on one picture only.
"${CARGO_TARGET_DIR:-target}/release/ssplat-lab" report tests/images/kodim15.png tests/images/kodim05.png --out "$out" \
    --ratios 50,200,1000 --efforts 1,3,5 --smartsplat-images 1 --stability "$out/tests.txt"
cp "$out/index.html" "$out/results.csv" "$out/results.json" "$out/anchors.csv" "$out/tables.md" docs/report/
