#!/bin/sh
# Builds the wheel, installs it into an empty virtual environment and checks it there, without Rust in PATH: types,
# tests, examples, notebook. `sh check.sh DIR` keeps environments and wheel in DIR, and `STGDAT_PYTHON` names the Python.
# Prints what it skips if Python or a package is not available.
set -eu
here=$(cd "$(dirname "$0")" && pwd)
root=$(cd "$here/../../.." && pwd)
mkdir -p "$1"
dir=$(cd "$1" && pwd)
python=${STGDAT_PYTHON:-python3}

skip() { printf 'skipped: %s\n' "$*"; exit 0; }
# Installs packages into the environment of this name.
install() {
    env="$dir/$1"
    shift
    [ -x "$env/bin/python" ] || "$python" -m venv "$env" || return 1
    "$env/bin/python" -m pip install --quiet --disable-pip-version-check --retries 1 --timeout 20 "$@"
}

command -v "$python" >/dev/null || skip "there is no $python"
install tools 'maturin>=1.9.4,<2' mypy numpy || skip 'maturin, mypy or numpy is not available'
rm -rf "$dir/wheels" "$dir/empty"
(cd "$here" && PATH="$dir/tools/bin:$PATH" maturin build --quiet --release --locked --out "$dir/wheels")
(cd "$root" && cargo build --quiet --release --locked --package stgdat --package stgdat-lab)
install empty "$(ls "$dir"/wheels/*.whl)"
extra=yes
install empty fsspec pyarrow || printf 'skipped: fsspec or pyarrow is not available\n'
install empty pandas pyarrow matplotlib nbconvert ipykernel || extra=no

program=$(cd "$root" && cargo metadata --format-version 1 --no-deps | "$python" -c \
    'import json, sys; print(json.load(sys.stdin)["target_directory"] + "/release/stgdat")')
# An empty PATH but for the system: nothing of Rust can be started.
alone() { (cd "$dir" && env -i HOME="$dir" PATH="$dir/empty/bin:/usr/bin:/bin" STGDAT_PROGRAM="$program" \
    STGDAT_CASES="${STGDAT_CASES:-$dir}" "$@"); }

(cd "$here" && "$dir/tools/bin/mypy" --config-file pyproject.toml)
install tools "$(ls "$dir"/wheels/*.whl)"
(cd "$dir" && "$dir/tools/bin/python" -m mypy.stubtest --ignore-disjoint-bases stgdat._stgdat)
alone python "$here/tests/test_stgdat.py"
alone python "$here/tests/test_fleet.py"
alone STGDAT_FIXTURES="$root/shared/data/tests/fixtures" python "$here/tests/test_datasets.py"
torch=${STGDAT_TORCH:-$python}
if "$torch" -c 'import numpy, safetensors, torch' 2>/dev/null; then
    rm -rf "$dir/torch"
    "$dir/tools/bin/python" -m pip install --quiet --disable-pip-version-check --no-deps --no-index \
        --target "$dir/torch" "$(ls "$dir"/wheels/*.whl)"
    for test in test_torch test_training; do
        alone PYTHONPATH="$dir/torch" STGDAT_GOLDEN="$root/tests/golden" \
            "$("$torch" -c 'import sys; print(sys.executable)')" "$here/tests/$test.py"
    done
else
    printf 'skipped: stgdat.torch: %s cannot import torch, safetensors and numpy; STGDAT_TORCH names a Python that can\n' \
        "$torch"
fi
alone python "$here/examples/stream.py" >"$dir/stream.txt"
printf 'wheel: %s bytes\n' "$(wc -c <"$(ls "$dir"/wheels/*.whl)")"
if [ "$extra" = no ]; then skip 'the notebook needs matplotlib, nbconvert and ipykernel'; fi
cp "$root/docs/notebooks/first_look.ipynb" "$dir"
alone python -m nbconvert --to notebook --execute --inplace --log-level ERROR first_look.ipynb
