# Completion of fleet's verbs, flags and names for fish; written by `fleet completion --shell fish`.

# `fab` belongs to other projects too.
function __fleet_here
    set --local typed (commandline --tokenize --current-process)
    test (basename -- $typed[1]) = fleet; or grep -qs 'fleet\.cli' fabfile.py
end

function __fleet_verb
    set --local typed (commandline --tokenize --current-process --cut-at-cursor)
    for word in $typed[2..]
        if not string match --quiet -- '-*' $word
            echo $word
            return
        end
    end
end

function __fleet_has_no_verb
    __fleet_here; and test (count (__fleet_verb)) -eq 0
end

function __fleet_has_verb
    __fleet_here; and contains -- $argv[1] (__fleet_verb)
    and not contains -- -- (commandline --tokenize --current-process --cut-at-cursor)
end

# __fleet_names KIND: of the inventory; after a comma, the next name of a list.
function __fleet_names
    set --local typed (commandline --tokenize --current-process)
    set --local inventory
    for index in (seq (count $typed))
        if string match --quiet -- '--inventory=*' $typed[$index]
            set inventory --inventory (string replace -- --inventory= '' $typed[$index])
        else if test $typed[$index] = --inventory; and test $index -lt (count $typed)
            set inventory --inventory $typed[(math $index + 1)]
        end
    end
    set --local current (string replace --regex -- '^--[a-z-]+=' '' (commandline --current-token --cut-at-cursor))
    set --local before (string match --regex -- '.*,' $current)
    for name in ($typed[1] completion --names $argv[1] $inventory 2>/dev/null </dev/null)
        echo "$before"$name
    end
end

for program in fleet fab
    complete --command $program --condition __fleet_here --no-files
@VERBS@
@FLAGS@
end
