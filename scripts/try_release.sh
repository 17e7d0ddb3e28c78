#!/usr/bin/env bash
# Install the built wheel in fresh environments, alone and with each extra, on each Python, and run a line of each.
#   scripts/try_release.sh [WHEEL]      default: the one in dist/
# PYTHONS="3.11 3.12 3.13" are the Pythons, in uv's words; EXTRAS="none rivals ..." the extras. Takes uv, and the network.
# Environments go below $TMPDIR and are removed. Prints a Markdown row for each, with its seconds; exit code 1 if any fails.
# shellcheck disable=SC2317  # `try` calls them
set -uo pipefail

wheel=$(realpath "${1:-$(echo "$(dirname "${BASH_SOURCE[0]}")"/../dist/*.whl)}") || exit 1
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
export OMP_NUM_THREADS=1
failures=0

# The first documented line of an extra.
line() {
    case $1 in
        none) lieednn-sim demo --no-video --output demo && lieednn-sim doctor ;;
        rivals) lieednn-sim plan --target extended --planner rrt-connect --output rrt ;;
        cbirrt)
            lieednn-sim plan --target extended --planner mjpl --output mjpl &&
                lieednn-sim plan --target extended --planner sscbirrt --output sscbirrt
            ;;
        timing) lieednn-sim demo --fastest --no-video --output fastest ;;
        view) lieednn-sim demo --no-video --output demo && lieednn-sim render demo --output motion.html ;;
        gymnasium)
            python - <<'PYTHON'
import gymnasium
from lieednn_sim.environments.expert import Expert

environment = gymnasium.make("lieednn_sim.environments.gymnasium:LieEDNN/TelescopicReach-v0")
expert = Expert(environment)
environment.reset(seed=0)
truncated = False
while not truncated:
    *_, truncated, info = environment.step(expert.act())
assert info["success"], info
PYTHON
            ;;
    esac
}

# $1 Python, $2 extra, then a command that is to succeed in an empty directory.
try() {
    local row="| $1 | $2 |" start=$SECONDS
    shift 2
    rm -rf "$work/empty"
    mkdir "$work/empty"
    if (cd "$work/empty" && "$@") >"$work/log" 2>&1; then
        echo "$row $((SECONDS - start)) |"
    else
        failures=$((failures + 1))
        echo "$row failed |"
        tail -n 20 "$work/log" >&2
    fi
}

fresh() {
    uv venv --quiet --clear --python "$1" "$work/venv" || return
    local path=$wheel
    [ "$2" = none ] || path="${wheel}[$2]"
    uv pip install --quiet --python "$work/venv" "$path" || return
    (
        PATH=$work/venv/bin:$PATH
        lieednn-sim --version && line "$2"
    )
}

echo "| Python | extra | seconds |"
echo "| --- | --- | --- |"
for python in ${PYTHONS:-3.11 3.12 3.13}; do
    for extra in ${EXTRAS:-none rivals cbirrt timing gymnasium view}; do
        try "$python" "$extra" fresh "$python" "$extra"
    done
    try "$python" "none, by uvx" uvx --python "$python" --from "$wheel" lieednn-sim demo --no-video
    try "$python" "none, by pipx run" uvx --python "$python" pipx run --spec "$wheel" lieednn-sim demo --no-video
    try "$python" "none, by pipx install" env PIPX_HOME="$work/pipx" PIPX_BIN_DIR="$work/bin" bash -c \
        "uvx --python $python pipx install --force '$wheel' && '$work/bin/lieednn-sim' demo --no-video"
done
exit $((failures > 0))
