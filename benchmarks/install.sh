#!/bin/sh
# Adds to the virtual environment VENV what only the benchmark needs, once: the competitors and what
# draws. LLVM, which Mitsuba compiles with, is a package of the system: root gets it here, anyone
# else one line to run, and a table without Mitsuba.
#   install.sh VENV
set -eu
venv=$1
root=$(cd "$(dirname "$0")/.." && pwd)

if ! cmp -s "$venv/installed" "$venv/installed-bench"; then
    echo "Installing the benchmark's packages into $venv (about 1 GB)"
    "$venv/bin/pip" install --quiet --disable-pip-version-check --editable "$root[bench]"
    cp "$venv/installed" "$venv/installed-bench"
fi

for library in /usr/lib/*/libLLVM.so.19*; do
    [ ! -e "$library" ] || exit 0
done
if [ "$(id -u)" -eq 0 ] && command -v apt-get >/dev/null; then
    apt-get update -qq
    DEBIAN_FRONTEND=noninteractive apt-get install -y --no-install-recommends libllvm19
else
    echo "Mitsuba is left out without LLVM: sudo apt-get install libllvm19" >&2
fi
