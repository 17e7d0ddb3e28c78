#!/usr/bin/env bash
# Make sure that the HTML page can be tested in a browser. Installs Chromium when it may; else says what to install.
# Always succeeds, because only the tests of the page need it.
set -euo pipefail

say() { printf '%s\n' "$*" >&2; }

packages=()
for name in chromium chromedriver; do
    command -v "$name" >/dev/null || packages+=("${name/chromedriver/chromium-driver}")
done
if [ ${#packages[@]} -eq 0 ]; then exit 0; fi

as_root=
if [ "$(id -u)" != 0 ]; then
    as_root=none
    if command -v sudo >/dev/null && sudo -n true 2>/dev/null; then as_root="sudo -n"; fi
fi

if [ "$as_root" != none ] && command -v apt-get >/dev/null; then
    say "Installing a browser for the tests of the HTML page: ${packages[*]}"
    $as_root apt-get update -qq >&2 || true
    $as_root env DEBIAN_FRONTEND=noninteractive apt-get install -qq -y --no-install-recommends "${packages[@]}" \
        >/dev/null || true
    if command -v chromium >/dev/null && command -v chromedriver >/dev/null; then exit 0; fi
fi

say "No browser: the tests of the HTML page are skipped."
say "To run them: apt-get install ${packages[*]}   (as root)"
