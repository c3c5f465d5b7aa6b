# fish completion for mien-studio
set mien_studio_first 'not __fish_seen_subcommand_from train fit inspect simulated-head record evaluate units nrsfm bake place head preview skin animate'
complete -c mien-studio -n $mien_studio_first -f -a train -d 'trains the face model (shape, appearance, confidence) and writes it to one file; prints the error on held-out people; with --paper-into only the paper’s own model, replaced in a model file that otherwise stays unchanged; with --person a model of the one person in a recording, who must go through all expressions there'
complete -c mien-studio -n '__fish_seen_subcommand_from train' -l images -r -F
complete -c mien-studio -n '__fish_seen_subcommand_from train' -l out -r -F
complete -c mien-studio -n '__fish_seen_subcommand_from train' -l tracks -r -F
complete -c mien-studio -n '__fish_seen_subcommand_from train' -l offsets -r -F
complete -c mien-studio -n '__fish_seen_subcommand_from train' -l data -r -F
complete -c mien-studio -n '__fish_seen_subcommand_from train' -l drawn -r -F
complete -c mien-studio -n '__fish_seen_subcommand_from train' -l starts -r -F
complete -c mien-studio -n '__fish_seen_subcommand_from train' -l seed -r -F
complete -c mien-studio -n '__fish_seen_subcommand_from train' -l refine -r -F
complete -c mien-studio -n '__fish_seen_subcommand_from train' -l paper-of -r -F
complete -c mien-studio -n '__fish_seen_subcommand_from train' -l paper-into -r -F
complete -c mien-studio -n '__fish_seen_subcommand_from train' -l person -r -F
complete -c mien-studio -n '__fish_seen_subcommand_from train' -l no-paper
complete -c mien-studio -n '__fish_seen_subcommand_from train' -l hold-out-dev
complete -c mien-studio -n $mien_studio_first -f -a fit -d 'fits landmarks to still pictures; reports the error if they are annotated'
complete -c mien-studio -n '__fish_seen_subcommand_from fit' -l images -r -F
complete -c mien-studio -n '__fish_seen_subcommand_from fit' -l out -r -F
complete -c mien-studio -n '__fish_seen_subcommand_from fit' -l model -r -F
complete -c mien-studio -n '__fish_seen_subcommand_from fit' -l box -r -F
complete -c mien-studio -n '__fish_seen_subcommand_from fit' -l boxes -r -F
complete -c mien-studio -n '__fish_seen_subcommand_from fit' -l offsets -r -F
complete -c mien-studio -n '__fish_seen_subcommand_from fit' -l pictures -r -F
complete -c mien-studio -n $mien_studio_first -f -a inspect -d 'shows a recording, a model, the CSV of a run or a mesh as pictures and plots; an HTML page plays the recording'
complete -c mien-studio -n '__fish_seen_subcommand_from inspect' -l out -r -F
complete -c mien-studio -n '__fish_seen_subcommand_from inspect' -l config -r -F
complete -c mien-studio -n '__fish_seen_subcommand_from inspect' -l model -r -F
complete -c mien-studio -n $mien_studio_first -f -a simulated-head -d 'rebuilds the simulated sensor’s built-in head from the training people'
complete -c mien-studio -n '__fish_seen_subcommand_from simulated-head' -l out -r -F
complete -c mien-studio -n '__fish_seen_subcommand_from simulated-head' -l data -r -F
complete -c mien-studio -n $mien_studio_first -f -a record -d 'records from the sensor or the simulator'
complete -c mien-studio -n '__fish_seen_subcommand_from record' -l out -r -F
complete -c mien-studio -n '__fish_seen_subcommand_from record' -l seconds -r -F
complete -c mien-studio -n '__fish_seen_subcommand_from record' -l source -r -F
complete -c mien-studio -n $mien_studio_first -f -a evaluate -d 'runs rendered sessions of held-out people through the whole pipeline and prints one table; with --landmarks the face model alone under every condition; with --heads scenes of one or several heads, hands and rooms; with --wild people with hair, clothes and accessories in front of a sensor with realistic faults; with --figures the figures of docs/paper.md, the paper’s system next to the default'
complete -c mien-studio -n '__fish_seen_subcommand_from evaluate' -l data -r -F
complete -c mien-studio -n '__fish_seen_subcommand_from evaluate' -l model -r -F
complete -c mien-studio -n '__fish_seen_subcommand_from evaluate' -l config -r -F
complete -c mien-studio -n '__fish_seen_subcommand_from evaluate' -l people -r -F
complete -c mien-studio -n '__fish_seen_subcommand_from evaluate' -l seconds -r -F
complete -c mien-studio -n '__fish_seen_subcommand_from evaluate' -l split -r -F
complete -c mien-studio -n '__fish_seen_subcommand_from evaluate' -l seed -r -F
complete -c mien-studio -n '__fish_seen_subcommand_from evaluate' -l rows -r -F
complete -c mien-studio -n '__fish_seen_subcommand_from evaluate' -l pictures -r -F
complete -c mien-studio -n '__fish_seen_subcommand_from evaluate' -l figures -r -F
complete -c mien-studio -n '__fish_seen_subcommand_from evaluate' -l landmarks
complete -c mien-studio -n '__fish_seen_subcommand_from evaluate' -l heads
complete -c mien-studio -n '__fish_seen_subcommand_from evaluate' -l wild
complete -c mien-studio -n $mien_studio_first -f -a units -d 'learns how each unit is computed from all measures together: the [[feature]] and [[reading]] tables of config/units.toml'
complete -c mien-studio -n '__fish_seen_subcommand_from units' -l data -r -F
complete -c mien-studio -n '__fish_seen_subcommand_from units' -l model -r -F
complete -c mien-studio -n '__fish_seen_subcommand_from units' -l config -r -F
complete -c mien-studio -n '__fish_seen_subcommand_from units' -l people -r -F
complete -c mien-studio -n '__fish_seen_subcommand_from units' -l seconds -r -F
complete -c mien-studio -n '__fish_seen_subcommand_from units' -l seed -r -F
complete -c mien-studio -n '__fish_seen_subcommand_from units' -l examples -r -F
complete -c mien-studio -n '__fish_seen_subcommand_from units' -l out -r -F
complete -c mien-studio -n $mien_studio_first -f -a nrsfm -d 'recovers moving 3D shapes from 2D tracks; reports the error if the ground truth is given'
complete -c mien-studio -n '__fish_seen_subcommand_from nrsfm' -l tracks -r -F
complete -c mien-studio -n '__fish_seen_subcommand_from nrsfm' -l rank -r -F
complete -c mien-studio -n '__fish_seen_subcommand_from nrsfm' -l out -r -F
complete -c mien-studio -n '__fish_seen_subcommand_from nrsfm' -l truth -r -F
complete -c mien-studio -n $mien_studio_first -f -a bake -d 'bakes 67 blendshapes onto a neutral head'
complete -c mien-studio -n '__fish_seen_subcommand_from bake' -l mesh -r -F
complete -c mien-studio -n '__fish_seen_subcommand_from bake' -l landmarks -r -F
complete -c mien-studio -n '__fish_seen_subcommand_from bake' -l out -r -F
complete -c mien-studio -n '__fish_seen_subcommand_from bake' -l recipe -r -F
complete -c mien-studio -n '__fish_seen_subcommand_from bake' -l controls -r -F
complete -c mien-studio -n '__fish_seen_subcommand_from bake' -l method -r -F
complete -c mien-studio -n '__fish_seen_subcommand_from bake' -l unit -r -F
complete -c mien-studio -n '__fish_seen_subcommand_from bake' -l obj -r -F
complete -c mien-studio -n '__fish_seen_subcommand_from bake' -l report -r -F
complete -c mien-studio -n '__fish_seen_subcommand_from bake' -l derive-controls
complete -c mien-studio -n '__fish_seen_subcommand_from bake' -l correctives
complete -c mien-studio -n '__fish_seen_subcommand_from bake' -l dense
complete -c mien-studio -n $mien_studio_first -f -a place -d 'serves a web page for dragging the 68 landmarks into place on a neutral head, with a preview of the resulting shapes'
complete -c mien-studio -n '__fish_seen_subcommand_from place' -l mesh -r -F
complete -c mien-studio -n '__fish_seen_subcommand_from place' -l landmarks -r -F
complete -c mien-studio -n '__fish_seen_subcommand_from place' -l out -r -F
complete -c mien-studio -n '__fish_seen_subcommand_from place' -l port -r -F
complete -c mien-studio -n $mien_studio_first -f -a head -d 'writes a coloured head to experiment with, and its landmarks in a .txt beside it: baked with 67 shapes and a neck that stays still (.glb), or neutral with its materials (.obj); with --make rebuilds the data the program makes it from'
complete -c mien-studio -n '__fish_seen_subcommand_from head' -l out -r -F
complete -c mien-studio -n '__fish_seen_subcommand_from head' -l make -r -F
complete -c mien-studio -n '__fish_seen_subcommand_from head' -l data -r -F
complete -c mien-studio -n $mien_studio_first -f -a preview -d 'serves a web page: the animated head, the units, their ranges, curves, pose and state'
complete -c mien-studio -n '__fish_seen_subcommand_from preview' -l osc -r -F
complete -c mien-studio -n '__fish_seen_subcommand_from preview' -l serial -r -F
complete -c mien-studio -n '__fish_seen_subcommand_from preview' -l baud -r -F
complete -c mien-studio -n '__fish_seen_subcommand_from preview' -l full -r -F
complete -c mien-studio -n '__fish_seen_subcommand_from preview' -l csv -r -F
complete -c mien-studio -n '__fish_seen_subcommand_from preview' -l source -r -F
complete -c mien-studio -n '__fish_seen_subcommand_from preview' -l model -r -F
complete -c mien-studio -n '__fish_seen_subcommand_from preview' -l config -r -F
complete -c mien-studio -n '__fish_seen_subcommand_from preview' -l box -r -F
complete -c mien-studio -n '__fish_seen_subcommand_from preview' -l mesh -r -F
complete -c mien-studio -n '__fish_seen_subcommand_from preview' -l port -r -F
complete -c mien-studio -n $mien_studio_first -f -a skin -d 'learns from sculpted shapes how skin moves, for bake; reports the error on held-out shapes'
complete -c mien-studio -n '__fish_seen_subcommand_from skin' -l out -r -F
complete -c mien-studio -n '__fish_seen_subcommand_from skin' -l data -r -F
complete -c mien-studio -n $mien_studio_first -f -a animate -d 'exports the weights of a run as a glTF animation'
complete -c mien-studio -n '__fish_seen_subcommand_from animate' -l mesh -r -F
complete -c mien-studio -n '__fish_seen_subcommand_from animate' -l csv -r -F
complete -c mien-studio -n '__fish_seen_subcommand_from animate' -l out -r -F
complete -c mien-studio -n '__fish_seen_subcommand_from animate' -l user -r -F
