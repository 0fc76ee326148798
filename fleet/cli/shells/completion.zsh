#compdef fleet fab
# Completion of fleet's verbs, flags and names for zsh; written by `fleet completion --shell zsh`.

_fleet_flags() {
    case "$1" in
@FLAGS@
    esac
}

_fleet_values() {
    case "$1" in
@VALUES@
    esac
}

# _fleet_names KIND: of the inventory; after a comma, the next name of a list.
_fleet_names() {
    local -a names
    names=(${(f)"$("${words[1]}" completion --names "$1" "${inventory[@]}" 2>/dev/null </dev/null)"})
    compset -P '*,'
    compadd -a names
}

_fleet() {
    local verb="" flag="" word="" values="" index
    local -a verbs flags inventory
    # `fab` belongs to other projects too.
    if [[ ${words[1]:t} == fab ]] && ! grep -qs 'fleet\.cli' fabfile.py; then
        _default
        return
    fi
    for ((index = 2; index < CURRENT; index++)); do
        word="${words[index]}"
        if [[ $word == -- ]]; then
            _default
            return
        fi
        [[ -z $verb && $word != -* ]] && verb="$word"
        [[ $word == --inventory=* ]] && inventory=(--inventory "${word#*=}")
        [[ ${words[index - 1]} == --inventory ]] && inventory=(--inventory "$word")
    done
    if [[ -z $verb ]]; then
        verbs=(
@VERBS@
        )
        _describe verb verbs
        return
    fi
    flag="${words[CURRENT - 1]}"
    if [[ ${words[CURRENT]} == --*=* ]]; then
        flag="${words[CURRENT]%%=*}"
        compset -P '*='
    fi
    values="$(_fleet_values "$verb $flag")"
    case "$values" in
        "") ;;
        names:*)
            _fleet_names "${values#names:}"
            return
            ;;
        file)
            _files
            return
            ;;
        text) return ;;
        *)
            compadd ${=values}
            return
            ;;
    esac
    flags=(${(f)"$(_fleet_flags "$verb")"})
    _describe flag flags
}

if [[ $funcstack[1] == _fleet ]]; then
    _fleet "$@"
else
    compdef _fleet fleet fab
fi
