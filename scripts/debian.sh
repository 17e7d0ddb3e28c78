# Sourced by the scripts that make an environment: installs Debian's packages where that may be done.
say() { printf '%s\n' "$*" >&2; }

# $1 what for, in words; then the packages. Does nothing where it may not, and always succeeds.
install_packages() {
    local as_root=
    [ "$(id -u)" = 0 ] || as_root="sudo -n"
    if [ $# -lt 2 ] || ! command -v apt-get >/dev/null || ! $as_root true 2>/dev/null; then return 0; fi
    say "Installing $1: ${*:2}"
    $as_root apt-get update -qq >&2 || true
    $as_root env DEBIAN_FRONTEND=noninteractive apt-get install -qq -y --no-install-recommends "${@:2}" >/dev/null || true
}
