#!/usr/bin/env bash
# Make .venv with the package in it, or leave it alone when it is up to date.
#   scripts/ensure_env.sh        what the demo needs
#   scripts/ensure_env.sh dev    and what the tests need
# PYTHON=... chooses the interpreter.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

extra=${1:-}
venv=.venv
stamp=$venv/.lieednn-sim${extra:+-$extra}

say() { printf '%s\n' "$*" >&2; }
die() { say "error: $*"; exit 1; }

supported() { "$1" -c 'import sys; sys.exit(not (3, 11) <= sys.version_info[:2] < (3, 13))' >/dev/null 2>&1; }
# ensurepip is what Debian leaves out without python3-venv; `import venv` works there.
can_make_venv() { "$1" -c 'import venv, ensurepip' >/dev/null 2>&1; }

# The environment is whole, its interpreter is still there, and it was made for this directory: a copied or moved
# checkout carries an environment that points back to the old one.
usable() {
    supported $venv/bin/python && $venv/bin/python -m pip --version >/dev/null 2>&1 &&
        { [ ! -e $venv/.made-in ] || [ "$(cat $venv/.made-in)" = "$PWD" ]; }
}

fresh() {
    local made
    for made in "$stamp" $venv/.lieednn-sim-dev; do
        if [ -e "$made" ] && [ ! pyproject.toml -nt "$made" ]; then return 0; fi
    done
    return 1
}

find_python() {
    local candidate fallback=
    for candidate in ${PYTHON:-python3.11 python3.12 python3 python}; do
        supported "$candidate" || continue
        if can_make_venv "$candidate"; then echo "$candidate"; return; fi
        fallback=${fallback:-$candidate}
    done
    echo "$fallback"
}

make_venv() {
    local python package
    python=$(find_python)
    if [ -z "$python" ]; then
        die "no Python 3.11 or 3.12 found (looked for: ${PYTHON:-python3.11 python3.12 python3 python});" \
            "on Debian 12: apt-get install python3 python3-venv; elsewhere: make PYTHON=/path/to/python3.12 ..."
    fi
    if ! can_make_venv "$python"; then
        # python3-venv belongs to Debian's default Python, pythonX.Y-venv to any other.
        package=$("$python" -c 'import sys; print("python%d.%d-venv" % sys.version_info[:2])')
        if "$python" -c 'import sys; sys.exit(sys.version_info[:2] != tuple(map(int, sys.argv[1].split("."))))' \
            "$(/usr/bin/python3 -c 'import sys; print("%d.%d" % sys.version_info[:2])' 2>/dev/null || echo 0.0)"; then
            package=python3-venv
        fi
        if [ "$(id -u)" = 0 ] && command -v apt-get >/dev/null; then
            say "Installing $package"
            apt-get update -qq >&2 || true
            DEBIAN_FRONTEND=noninteractive apt-get install -qq -y --no-install-recommends "$package" >/dev/null || true
        fi
        can_make_venv "$python" || die "$python cannot make virtual environments: apt-get install $package"
    fi
    say "Making $venv with $("$python" --version 2>&1)"
    "$python" -m venv --clear $venv || die "could not make $venv"
    printf '%s\n' "$PWD" >$venv/.made-in
}

usable || make_venv
if ! fresh; then
    say "Installing lieednn_sim${extra:+ with its $extra tools} into $venv; the first time this takes some minutes"
    $venv/bin/python -m pip install --quiet --disable-pip-version-check --editable ".${extra:+[$extra]}"
    printf '%s\n' "$PWD" >$venv/.made-in
    touch "$stamp"
fi
