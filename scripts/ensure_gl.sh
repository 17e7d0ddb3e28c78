#!/usr/bin/env bash
# Make sure that MuJoCo can render without a display. Installs what is missing when it may; else says what to install.
# Always succeeds, because everything but rendering works without OpenGL.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

say() { printf '%s\n' "$*" >&2; }
ask() { .venv/bin/python -m lieednn_sim.rendering.opengl 2>/dev/null; }

if packages=$(ask); then exit 0; fi

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
    if ask >/dev/null; then exit 0; fi
fi

say "No rendering: going on without video."
.venv/bin/python -m lieednn_sim.rendering.opengl >/dev/null || true
if [ -n "$packages" ]; then say "To get video: apt-get install $packages   (as root)"; fi
