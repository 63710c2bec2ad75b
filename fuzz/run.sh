#!/usr/bin/env bash
# Fuzzes every target for so many seconds; succeeds with a reason where that cannot be done.
set -euo pipefail
cd "$(dirname "$0")/.."
seconds=${1:?seconds per target}

skip() {
    echo "fuzzing skipped: $1"
    exit 0
}

cargo +nightly --version >/dev/null 2>&1 || skip "no nightly toolchain (rustup toolchain install nightly)"
cargo +nightly fuzz --version >/dev/null 2>&1 || skip "no cargo-fuzz (cargo install cargo-fuzz --locked)"
c++ --version >/dev/null 2>&1 || skip "no C++ compiler, which libFuzzer is built with"

for target in fragments params scenes weights; do
    echo "fuzzing $target for $seconds s"
    mkdir -p "fuzz/corpus/$target" "fuzz/seeds/$target"
    cargo +nightly fuzz run "$target" "fuzz/corpus/$target" "fuzz/seeds/$target" -- -max_total_time="$seconds" -timeout=20 -max_len=2000 \
        -rss_limit_mb=4096 -verbosity=0
done
