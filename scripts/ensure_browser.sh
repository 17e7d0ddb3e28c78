#!/usr/bin/env bash
# Make sure that the HTML page can be tested in a browser. Installs Chromium when it may; else says what to install.
# Always succeeds, because only the tests of the page need it.
set -euo pipefail
. "$(dirname "${BASH_SOURCE[0]}")/debian.sh"

there() { command -v chromium >/dev/null && command -v chromedriver >/dev/null; }

if there; then exit 0; fi
packages=(chromium chromium-driver)
install_packages "a browser for the tests of the HTML page" "${packages[@]}"
if there; then exit 0; fi

say "No browser: the tests of the HTML page are skipped."
say "To run them: apt-get install ${packages[*]}   (as root)"
