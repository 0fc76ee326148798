# Completion of fleet's verbs, flags and names for bash; written by `fleet completion --shell bash`.
# shellcheck shell=bash

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

# _fleet_words WORD...: those that begin with what is typed.
_fleet_words() {
    mapfile -t COMPREPLY < <(compgen -W "$*" -- "$current")
}

# _fleet_names KIND: of the inventory; after a comma, the next name of a list.
_fleet_names() {
    local typed="${current##*,}" before="" names
    [[ $current == *,* ]] && before="${current%,*},"
    names=$("${COMP_WORDS[0]}" completion --names "$1" "${inventory[@]}" 2>/dev/null </dev/null)
    mapfile -t COMPREPLY < <(compgen -P "$before" -W "$names" -- "$typed")
}

_fleet() {
    local current="${COMP_WORDS[COMP_CWORD]}" flag="" verb="" word="" before="" values="" index=0
    local -a inventory=()
    COMPREPLY=()
    # `fab` belongs to other projects too.
    if [[ ${COMP_WORDS[0]##*/} == fab ]] && ! grep -qs 'fleet\.cli' fabfile.py; then
        return
    fi
    for ((index = 1; index < COMP_CWORD; index++)); do
        word="${COMP_WORDS[index]}"
        [[ $word == -- ]] && return
        [[ -z $verb && $word != -* ]] && verb="$word"
        # bash makes three words of --inventory=FILE.
        [[ $word == = ]] && continue
        [[ $before == --inventory ]] && inventory=(--inventory "$word")
        before="$word"
    done
    flag="${COMP_WORDS[COMP_CWORD - 1]}"
    if [[ $current == = ]]; then
        current=""
    elif [[ $flag == = ]]; then
        flag="${COMP_WORDS[COMP_CWORD - 2]}"
    fi
    if [[ -z $verb ]]; then
        _fleet_words @VERBS@
        return
    fi
    values="$(_fleet_values "$verb $flag")"
    case "$values" in
        "") ;;
        names:*)
            _fleet_names "${values#names:}"
            return
            ;;
        file)
            compopt -o filenames
            mapfile -t COMPREPLY < <(compgen -f -- "$current")
            return
            ;;
        text) return ;;
        *)
            _fleet_words "$values"
            return
            ;;
    esac
    _fleet_words "$(_fleet_flags "$verb")"
}

complete -F _fleet fleet
complete -o bashdefault -o default -F _fleet fab
