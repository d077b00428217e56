#!/bin/sh
# Counts the instructions of one forward and backward pass of some kernels, on one thread, by callgrind: a number that does not
# depend on what else the machine does, so that two versions can be compared exactly.
#
#     benches/instructions.sh [KERNEL...]       all of them by default
#
# The counts are those of the instruction set that valgrind knows (AVX2 at most, whatever the processor has): kernels choose theirs
# at run time.
set -eu
cd "$(dirname "$0")/.."

if ! command -v valgrind >/dev/null; then
    echo "instructions.sh: valgrind is not installed (Debian: apt-get install valgrind); nothing was counted" >&2
    exit 2
fi
cargo build --quiet --release -p dimode-benches --bin once
once="${CARGO_TARGET_DIR:-target}/release/once"
[ $# -gt 0 ] || set -- $("$once")

printf '%-20s %16s\n' kernel instructions
for kernel in "$@"; do
    log=$(mktemp)
    if ! valgrind --tool=callgrind --callgrind-out-file=/dev/null --collect-atstart=no --toggle-collect='*counted_region*' \
        "$once" "$kernel" 2>"$log"; then
        cat "$log" >&2
        exit 1
    fi
    printf '%-20s %16s\n' "$kernel" "$(sed -n 's/.*Collected : \([0-9]*\).*/\1/p' "$log")"
    rm -f "$log"
done
