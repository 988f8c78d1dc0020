#!/bin/sh
# compile_shader.sh GLSLANG SPIRV_VAL SOURCE OUTPUT [FLAGS...]: compiles one shader; warnings fail the build.
set -eu
glslang=$1 spirv_val=$2 source=$3 output=$4
shift 4
if ! text=$("$glslang" -V --target-env vulkan1.3 "$@" -o "$output" "$source" 2>&1) ||
    printf '%s\n' "$text" | grep -qiE '^(warning|error)|: (warning|error)'; then
    printf '%s\n' "$text" >&2
    rm -f "$output"
    exit 1
fi
"$spirv_val" --target-env vulkan1.3 --scalar-block-layout "$output" || {
    rm -f "$output"
    exit 1
}
