#!/usr/bin/env bash
# Make sure that MuJoCo can render without a display. Installs what is missing when it may; else says what to install.
# Always succeeds, because everything but rendering works without OpenGL.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
. scripts/debian.sh

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
# shellcheck disable=SC2086  # a list of words
install_packages "OpenGL for rendering without a display" $packages
if ask >/dev/null 2>&1; then exit 0; fi

say "No rendering: going on without video."
ask >/dev/null || true
if [ -n "$packages" ]; then say "To get video: apt-get install $packages   (as root)"; fi
