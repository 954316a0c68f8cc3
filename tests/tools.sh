# Sourced by the scripts that need Python or a browser; they set `what`, which a skipped part is called by. All Python
# packages are in one virtual environment below the target folder, installed once. Debian's packages are installed only
# where STICTIOND_INSTALL=1 asks for it, by root; without them the part is skipped and says so.
target=${CARGO_TARGET_DIR:-target}

skip() {
    printf '\n!! SKIPPED: %s: %s\n\n' "$what" "$*" >&2
    exit 0
}

install() {
    if [ "${STICTIOND_INSTALL:-}" = 1 ] && [ "$(id -u)" = 0 ] && command -v apt-get >/dev/null; then
        { apt-get update && apt-get install -y --no-install-recommends "$@"; } >/dev/null 2>&1 || true
    fi
}

# Sets `python`, which has the packages of tests/requirements.txt, and `bin`, the folder of their programs.
use_python() {
    python=""
    local candidate
    for candidate in "${PYTHON:-}" python3.11 python3; do
        if [ -n "$candidate" ] && command -v "$candidate" >/dev/null \
            && "$candidate" -c 'import sys; sys.exit(sys.version_info < (3, 11))'; then
            python=$candidate
            break
        fi
    done
    [ -n "$python" ] || skip "no Python 3.11 or newer"
    local venv=$target/python stamp
    stamp=$venv/$(sha256sum tests/requirements.txt | cut -c 1-16)
    mkdir -p "$target"
    # Whoever installs in the background is waited for.
    if command -v flock >/dev/null; then
        exec 9>"$target/python.lock"
        flock 9
    fi
    if [ ! -e "$stamp" ]; then
        rm -rf "$venv"
        "$python" -c 'import ensurepip' 2>/dev/null || install python3-venv
        local pip=("$python" -m pip)
        if "$python" -m venv "$venv" 2>/dev/null; then
            pip=("$venv/bin/python" -m pip)
            "${pip[@]}" install --quiet --disable-pip-version-check -r tests/requirements.txt || skip "Python packages cannot be had"
        else
            # Without venv, pip can do with a folder.
            rm -rf "$venv"
            "${pip[@]}" install --quiet --disable-pip-version-check --target "$venv" -r tests/requirements.txt \
                || skip "Python packages cannot be had, nor venv (apt-get install python3-venv, or STICTIOND_INSTALL=1)"
        fi
        touch "$stamp"
    fi
    exec 9>&-
    if [ -x "$venv/bin/python" ]; then
        python=$venv/bin/python
    else
        export PYTHONPATH=$PWD/$venv
    fi
    bin=$venv/bin
}

# Sets `browser`.
use_browser() {
    browser=${CHROMIUM:-$(command -v chromium || command -v chromium-browser || command -v google-chrome || true)}
    if [ -z "$browser" ]; then
        install chromium fonts-dejavu-core
        browser=$(command -v chromium || true)
    fi
    [ -n "$browser" ] || skip "no chromium (apt-get install chromium, STICTIOND_INSTALL=1, or set CHROMIUM)"
}
