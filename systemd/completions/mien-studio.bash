# bash completion for mien-studio
_mien_studio() {
  local word=${COMP_WORDS[COMP_CWORD]}
  if [ "$COMP_CWORD" -eq 1 ]; then
    COMPREPLY=($(compgen -W 'train fit inspect simulated-head record evaluate units nrsfm bake place head preview skin animate help --help --version' -- "$word"))
    return
  fi
  if [[ $word != -* ]]; then
    COMPREPLY=($(compgen -f -- "$word"))
    return
  fi
  case ${COMP_WORDS[1]} in
    train) COMPREPLY=($(compgen -W '--images --out --tracks --offsets --data --drawn --starts --seed --refine --paper-of --paper-into --person --no-paper --hold-out-dev --help' -- "$word")) ;;
    fit) COMPREPLY=($(compgen -W '--images --out --model --box --boxes --offsets --pictures --help' -- "$word")) ;;
    inspect) COMPREPLY=($(compgen -W '--out --config --model --help' -- "$word")) ;;
    simulated-head) COMPREPLY=($(compgen -W '--out --data --help' -- "$word")) ;;
    record) COMPREPLY=($(compgen -W '--out --seconds --source --help' -- "$word")) ;;
    evaluate) COMPREPLY=($(compgen -W '--data --model --config --people --seconds --split --seed --rows --pictures --figures --landmarks --heads --wild --help' -- "$word")) ;;
    units) COMPREPLY=($(compgen -W '--data --model --config --people --seconds --seed --examples --out --help' -- "$word")) ;;
    nrsfm) COMPREPLY=($(compgen -W '--tracks --rank --out --truth --help' -- "$word")) ;;
    bake) COMPREPLY=($(compgen -W '--mesh --landmarks --out --recipe --controls --method --unit --obj --report --derive-controls --correctives --dense --help' -- "$word")) ;;
    place) COMPREPLY=($(compgen -W '--mesh --landmarks --out --port --help' -- "$word")) ;;
    head) COMPREPLY=($(compgen -W '--out --make --data --help' -- "$word")) ;;
    preview) COMPREPLY=($(compgen -W '--osc --serial --baud --full --csv --source --model --config --box --mesh --port --help' -- "$word")) ;;
    skin) COMPREPLY=($(compgen -W '--out --data --help' -- "$word")) ;;
    animate) COMPREPLY=($(compgen -W '--mesh --csv --out --user --help' -- "$word")) ;;
  esac
}
complete -o filenames -F _mien_studio mien-studio
