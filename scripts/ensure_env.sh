#!/usr/bin/env bash
# Make .venv with the package in it, or leave it alone when it is up to date; then nothing is asked of the network.
#   scripts/ensure_env.sh        what the demo and the first examples need; messages name the extras of the others
#   scripts/ensure_env.sh dev    all extras, and what the tests need
# PYTHON=... chooses the interpreter. A .venv that this script did not make is used when it can be, and never removed.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
. scripts/debian.sh

wanted=${1:-demo}
venv=.venv
made_in=$venv/.made-in
extras=view
group=
if [ "$wanted" = dev ]; then
    extras=$extras,gymnasium,rivals,timing,cbirrt,onnx,ros2,lerobot,rerun
    group="--group dev"
fi
if [ -n "${PYTHON:-}" ]; then pythons=("$PYTHON"); else pythons=(python3.11 python3.12 python3.13 python3 python); fi

die() { say "error: $*"; exit 1; }

supported() { "$1" -c 'import sys; sys.exit(not (3, 11) <= sys.version_info[:2] < (3, 14))' >/dev/null 2>&1; }
# ensurepip is what Debian leaves out without python3-venv; `import venv` works there.
can_make_venv() { "$1" -c 'import venv, ensurepip' >/dev/null 2>&1; }
ours() { [ -f $made_in ] && [ ! -L $venv ]; }

# Why the environment cannot be used; nothing when it can. A copied or moved checkout carries one that points back.
fault() {
    if ! supported $venv/bin/python; then
        echo "has no Python 3.11, 3.12 or 3.13 that runs"
    elif ! $venv/bin/python -m pip --version >/dev/null 2>&1; then
        echo "has no pip (.venv/bin/python -m ensurepip adds it)"
    elif [ -e $made_in ] && [ "$(cat $made_in)" != "$PWD" ]; then
        echo "was made for $(cat $made_in)"
    fi
}

find_python() {
    local candidate fallback=
    for candidate in "${pythons[@]}"; do
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
        die "no Python 3.11, 3.12 or 3.13 found (looked for: ${pythons[*]});" \
            "on Debian: apt-get install python3 python3-venv; elsewhere: make PYTHON=/path/to/python3.12 ..."
    fi
    if ! can_make_venv "$python"; then
        # python3-venv belongs to Debian's default Python, pythonX.Y-venv to any other.
        package=$("$python" -c 'import sys; print("python%d.%d-venv" % sys.version_info[:2])')
        if "$python" -c 'import sys; sys.exit(sys.version_info[:2] != tuple(map(int, sys.argv[1].split("."))))' \
            "$(/usr/bin/python3 -c 'import sys; print("%d.%d" % sys.version_info[:2])' 2>/dev/null || echo 0.0)"; then
            package=python3-venv
        fi
        install_packages "what makes virtual environments" "$package"
        can_make_venv "$python" || die "$python cannot make virtual environments: apt-get install $package"
    fi
    say "Making $venv with $("$python" --version 2>&1)"
    rm -rf $venv
    # The mark comes first, so that an environment left half made is known for our own.
    mkdir $venv
    printf '%s\n' "$PWD" >$made_in
    "$python" -m venv $venv || die "could not make $venv"
}

# What an environment is made from: the metadata of the package, wherever it lies. Not the time of the file, which git sets.
digest() {
    $venv/bin/python - "$PWD" <<'PYTHON'
import hashlib, json, sys, tomllib
with open("pyproject.toml", "rb") as file:
    content = tomllib.load(file)
parts = [content["build-system"], content["project"], content["dependency-groups"], content.get("tool", {}).get("hatch"), sys.argv[1]]
print(hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest())
PYTHON
}

# Whoever can test can run the demo.
fresh() {
    local name
    for name in "$wanted" dev; do
        if [ "$(cat $venv/.lieednn-sim-"$name" 2>/dev/null)" = "$now" ]; then return 0; fi
    done
    return 1
}

pip() { $venv/bin/python -m pip "$1" --quiet --disable-pip-version-check "${@:2}"; }
# Python compiles what is imported.
pip_install() { pip install --no-compile "$@"; }

# fontTools without its compiled parts, with which nothing here would be faster; where it cannot be had, pip takes all.
small_fonttools() {
    local wheels
    wheels=$(mktemp -d)
    if pip download --no-deps --only-binary=:all: --platform any --dest "$wheels" fonttools 2>/dev/null; then
        pip_install --no-deps "$wheels"/*.whl || true
    fi
    rm -rf "$wheels"
}

wrong=
if [ -e $venv ] || [ -L $venv ]; then
    wrong=$(fault)
    if [ -n "$wrong" ] && ! ours; then
        die "$venv $wrong. This script did not make it here, and leaves it alone:" \
            "mend it, or move it away, and run the same command again"
    fi
fi
if [ -n "$wrong" ] || [ ! -e $venv ]; then make_venv; fi

now=$(digest)
if ! fresh; then
    was=$(ls $venv/.lieednn-sim-* 2>/dev/null || true)
    say "Installing lieednn_sim with the extras $extras into $venv; the first time this takes some minutes"
    if [ -z "$was" ]; then small_fonttools; fi
    # Dependency groups came with pip 25.1. Later releases of the film's encoder and of zstandard have twice their size.
    if ! { { [ -z "$group" ] || pip_install 'pip>=25.1'; } &&
        pip_install --editable ".[$extras]" $group 'imageio-ffmpeg<0.8' 'zstandard<0.22; python_version < "3.12"'; }; then
        if [ -n "$was" ]; then
            die "pip could not bring $venv up to date with pyproject.toml (its reason is above); without a network," \
                "try again later, or run what is there, as it is: $venv/bin/lieednn-sim"
        fi
        die "pip could not install lieednn_sim (its reason is above); the first time it needs the network"
    fi
    # What making the environment compiled, of pip itself; and the tests of the two largest, which nothing imports.
    if ours; then
        find $venv/lib/*/site-packages/{pip,setuptools,pkg_resources}/ -name __pycache__ -prune -exec rm -rf {} + || true
        find $venv/lib/*/site-packages/{numpy,scipy}/ -type d -name tests -prune -exec rm -rf {} + || true
    fi 2>/dev/null
    printf '%s\n' "$now" >$venv/.lieednn-sim-"$wanted"
fi
