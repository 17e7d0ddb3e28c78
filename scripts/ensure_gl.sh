#!/usr/bin/env bash
# Make sure that MuJoCo can render without a display. Installs what is missing when it may; else says what to install.
# Always succeeds, because everything but rendering works without OpenGL.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

say() { printf '%s\n' "$*" >&2; }
# Prints the packages that are missing; succeeds where there is OpenGL.
ask() {
    (.venv/bin/lieednn-sim doctor --json || true) | .venv/bin/python -c '
import json, sys
found = json.load(sys.stdin)
print(*found["debian_packages_to_install"])
print(found["opengl"]["detail"], file=sys.stderr)
sys.exit(found["opengl"]["backend"] == "disable")'
}

if packages=$(ask 2>/dev/null); then exit 0; fi

as_root=
if [ "$(id -u)" != 0 ]; then
    as_root=none
    if command -v sudo >/dev/null && sudo -n true 2>/dev/null; then as_root="sudo -n"; fi
fi

if [ -n "$packages" ] && [ "$as_root" != none ] && command -v apt-get >/dev/null; then
    say "Installing OpenGL for rendering without a display: $packages"
    $as_root apt-get update -qq >&2 || true
    # shellcheck disable=SC2086  # both are lists of words
    $as_root env DEBIAN_FRONTEND=noninteractive apt-get install -qq -y --no-install-recommends $packages >/dev/null || true
    if ask >/dev/null 2>&1; then exit 0; fi
fi

say "No rendering: going on without video."
ask >/dev/null || true
if [ -n "$packages" ]; then say "To get video: apt-get install $packages   (as root)"; fi
