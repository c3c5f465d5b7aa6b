# Print an optspec for argparse to handle cmd's options that are independent of any subcommand.
function __fish_mien_studio_global_optspecs
    string join \n h/help V/version
end

function __fish_mien_studio_needs_command
    # Figure out if the current invocation already has a command.
    set -l cmd (commandline -opc)
    set -e cmd[1]
    argparse -s (__fish_mien_studio_global_optspecs) -- $cmd 2>/dev/null
    or return
    if set -q argv[1]
        # Also print the command, so this can be used to figure out what it is.
        echo $argv[1]
        return 1
    end
    return 0
end

function __fish_mien_studio_using_subcommand
    set -l cmd (__fish_mien_studio_needs_command)
    test -z "$cmd"
    and return 1
    contains -- $cmd[1] $argv
end

complete -c mien-studio -n "__fish_mien_studio_needs_command" -s h -l help -d 'Print help'
complete -c mien-studio -n "__fish_mien_studio_needs_command" -s V -l version -d 'Print version'
complete -c mien-studio -n "__fish_mien_studio_needs_command" -f -a "train" -d 'Train the face model (shape, appearance, confidence) into one file; prints the error on held-out people'
complete -c mien-studio -n "__fish_mien_studio_needs_command" -f -a "fit" -d 'Fit landmarks to still pictures; reports the error if they are annotated'
complete -c mien-studio -n "__fish_mien_studio_needs_command" -f -a "inspect" -d 'Show a recording, a model, the CSV of a run or a mesh as pictures and plots; an HTML page plays the recording'
complete -c mien-studio -n "__fish_mien_studio_needs_command" -f -a "simulated-head" -d 'Rebuild the simulated sensor\'s built-in head from the training people'
complete -c mien-studio -n "__fish_mien_studio_needs_command" -f -a "record" -d 'Record from the sensor or the simulator'
complete -c mien-studio -n "__fish_mien_studio_needs_command" -f -a "evaluate" -d 'Run rendered sessions of held-out people through the whole pipeline and print one table'
complete -c mien-studio -n "__fish_mien_studio_needs_command" -f -a "units" -d 'Learn how each unit is computed from all measures together: [[feature]] and [[reading]] of config/units.toml'
complete -c mien-studio -n "__fish_mien_studio_needs_command" -f -a "nrsfm" -d 'Recover moving 3D shapes from 2D tracks; reports the error if the ground truth is given'
complete -c mien-studio -n "__fish_mien_studio_needs_command" -f -a "bake" -d 'Bake 67 blendshapes onto a neutral head'
complete -c mien-studio -n "__fish_mien_studio_needs_command" -f -a "place" -d 'Serve a web page for dragging the 68 landmarks into place on a neutral head, with a preview of the shapes'
complete -c mien-studio -n "__fish_mien_studio_needs_command" -f -a "head" -d 'Write a coloured head to experiment with, and its landmarks in a .txt beside it: baked with 67 shapes and a neck that stays still (.glb), or neutral with its materials (.obj)'
complete -c mien-studio -n "__fish_mien_studio_needs_command" -f -a "preview" -d 'Serve a web page: the animated head, the units, their ranges, curves, pose and state'
complete -c mien-studio -n "__fish_mien_studio_needs_command" -f -a "skin" -d 'Learn from sculpted shapes how skin moves, for bake'
complete -c mien-studio -n "__fish_mien_studio_needs_command" -f -a "animate" -d 'Export the weights of a run as a glTF animation'
complete -c mien-studio -n "__fish_mien_studio_needs_command" -f -a "help" -d 'Print this message or the help of the given subcommand(s)'
complete -c mien-studio -n "__fish_mien_studio_using_subcommand train" -l images -d 'Folders of annotated portraits' -r -F
complete -c mien-studio -n "__fish_mien_studio_using_subcommand train" -l out -d 'Model file to write' -r -F
complete -c mien-studio -n "__fish_mien_studio_using_subcommand train" -l data -d 'Folder of the data sets' -r -F
complete -c mien-studio -n "__fish_mien_studio_using_subcommand train" -l drawn -d 'Faces drawn for training' -r
complete -c mien-studio -n "__fish_mien_studio_using_subcommand train" -l starts -d 'Disturbed starts for each portrait and its mirror image' -r
complete -c mien-studio -n "__fish_mien_studio_using_subcommand train" -l seed -d 'Seed of everything random' -r
complete -c mien-studio -n "__fish_mien_studio_using_subcommand train" -l tracks -d 'Tracks of an actor, to give the paper\'s model that actor\'s 3D shape [default: a rendered actor]' -r -F
complete -c mien-studio -n "__fish_mien_studio_using_subcommand train" -l offsets -d 'Where to write the mean offset of each landmark' -r -F
complete -c mien-studio -n "__fish_mien_studio_using_subcommand train" -l paper-of -d 'Keep the paper\'s appearance model of this model file' -r -F
complete -c mien-studio -n "__fish_mien_studio_using_subcommand train" -l paper-into -d 'Train the paper\'s appearance model alone and put it into this model file, which otherwise stays the same' -r -F
complete -c mien-studio -n "__fish_mien_studio_using_subcommand train" -l person -d 'A recording of one person who goes through all expressions: train a model of that person alone' -r -F
complete -c mien-studio -n "__fish_mien_studio_using_subcommand train" -l hold-out-dev -d 'Also hold out the people used for choosing settings, to measure on them'
complete -c mien-studio -n "__fish_mien_studio_using_subcommand train" -s h -l help -d 'Print help'
complete -c mien-studio -n "__fish_mien_studio_using_subcommand fit" -l images -d 'Folder of pictures, annotated or not' -r -F
complete -c mien-studio -n "__fish_mien_studio_using_subcommand fit" -l out -d 'Table of the points: file, confidence, x0, y0, ... in pixels of the file' -r -F
complete -c mien-studio -n "__fish_mien_studio_using_subcommand fit" -l model -d 'Face model [default: the built-in one]' -r -F
complete -c mien-studio -n "__fish_mien_studio_using_subcommand fit" -l box -d 'One face box x,y,w,h for all pictures [default: the annotation\'s, disturbed]' -r
complete -c mien-studio -n "__fish_mien_studio_using_subcommand fit" -l boxes -d 'Table of face boxes: file, x, y, w, h' -r -F
complete -c mien-studio -n "__fish_mien_studio_using_subcommand fit" -l offsets -d 'Mean offset of each landmark, as train writes them, to take out of the error' -r -F
complete -c mien-studio -n "__fish_mien_studio_using_subcommand fit" -s h -l help -d 'Print help'
complete -c mien-studio -n "__fish_mien_studio_using_subcommand inspect" -l out -d 'Page or picture to write, .html or .png' -r -F
complete -c mien-studio -n "__fish_mien_studio_using_subcommand inspect" -l model -d 'Face model [default: the built-in one]' -r -F
complete -c mien-studio -n "__fish_mien_studio_using_subcommand inspect" -l config -d 'Configuration [default: the built-in one]' -r -F
complete -c mien-studio -n "__fish_mien_studio_using_subcommand inspect" -s h -l help -d 'Print help'
complete -c mien-studio -n "__fish_mien_studio_using_subcommand simulated-head" -l out -d 'The head to write' -r -F
complete -c mien-studio -n "__fish_mien_studio_using_subcommand simulated-head" -l data -d 'Folder of the data sets' -r -F
complete -c mien-studio -n "__fish_mien_studio_using_subcommand simulated-head" -s h -l help -d 'Print help'
complete -c mien-studio -n "__fish_mien_studio_using_subcommand record" -l out -d 'Folder to write; plays with --source FOLDER of mien and mien-studio' -r -F
complete -c mien-studio -n "__fish_mien_studio_using_subcommand record" -l seconds -d 'How long; Ctrl-C keeps what there is' -r
complete -c mien-studio -n "__fish_mien_studio_using_subcommand record" -l source -d 'kinect, simulated[:KIND] or a folder; without a Kinect the simulator' -r
complete -c mien-studio -n "__fish_mien_studio_using_subcommand record" -s h -l help -d 'Print help'
complete -c mien-studio -n "__fish_mien_studio_using_subcommand evaluate" -l data -d 'Folder of the data sets' -r -F
complete -c mien-studio -n "__fish_mien_studio_using_subcommand evaluate" -l model -d 'Face model [default: the built-in one]' -r -F
complete -c mien-studio -n "__fish_mien_studio_using_subcommand evaluate" -l config -d 'Configuration [default: the built-in one]' -r -F
complete -c mien-studio -n "__fish_mien_studio_using_subcommand evaluate" -l people -d 'At most this many people of the split [default: all; 4 with --heads, 1 with --paper]' -r
complete -c mien-studio -n "__fish_mien_studio_using_subcommand evaluate" -l seconds -d 'Length of a session [default: 45; 5 with --landmarks, 10 with --heads, 20 with --wild and --paper]' -r
complete -c mien-studio -n "__fish_mien_studio_using_subcommand evaluate" -l split -d 'Whose sessions: test (never looked at while building), dev (for choosing settings) or train' -r -f -a "train\t'Training'
dev\t'Choosing settings (`train --hold-out-dev` keeps them out); trained on in the end, as for the shipped model'
test\t'Figures that are reported. Never trained on, never tuned on'"
complete -c mien-studio -n "__fish_mien_studio_using_subcommand evaluate" -l seed -d 'Seed of everything random' -r
complete -c mien-studio -n "__fish_mien_studio_using_subcommand evaluate" -l rows -d 'Only these rows of --heads or --paper, separated by commas' -r
complete -c mien-studio -n "__fish_mien_studio_using_subcommand evaluate" -l landmarks -d 'The face model alone: every condition on drawn and on real faces'
complete -c mien-studio -n "__fish_mien_studio_using_subcommand evaluate" -l heads -d 'Scenes of one and several heads, hands and rooms'
complete -c mien-studio -n "__fish_mien_studio_using_subcommand evaluate" -l wild -d 'People with hair, clothes and accessories before a sensor with realistic faults'
complete -c mien-studio -n "__fish_mien_studio_using_subcommand evaluate" -l paper -d 'The experiments of docs/paper.md: the paper\'s system next to the default'
complete -c mien-studio -n "__fish_mien_studio_using_subcommand evaluate" -s h -l help -d 'Print help (see more with \'--help\')'
complete -c mien-studio -n "__fish_mien_studio_using_subcommand units" -l data -d 'Folder of the data sets' -r -F
complete -c mien-studio -n "__fish_mien_studio_using_subcommand units" -l model -d 'Face model [default: the built-in one]' -r -F
complete -c mien-studio -n "__fish_mien_studio_using_subcommand units" -l config -d 'Configuration [default: the built-in one]' -r -F
complete -c mien-studio -n "__fish_mien_studio_using_subcommand units" -l people -d 'People who act' -r
complete -c mien-studio -n "__fish_mien_studio_using_subcommand units" -l seconds -d 'Seconds of each' -r
complete -c mien-studio -n "__fish_mien_studio_using_subcommand units" -l seed -d 'Seed of everything random' -r
complete -c mien-studio -n "__fish_mien_studio_using_subcommand units" -l examples -d 'File with what they acted: read if it exists, else written, so that another try takes seconds' -r -F
complete -c mien-studio -n "__fish_mien_studio_using_subcommand units" -l out -d 'Where to write the tables [default: standard output]' -r -F
complete -c mien-studio -n "__fish_mien_studio_using_subcommand units" -s h -l help -d 'Print help'
complete -c mien-studio -n "__fish_mien_studio_using_subcommand nrsfm" -l tracks -d '2F x P image tracks: x row, y row per frame; a missing point empty or nan' -r -F
complete -c mien-studio -n "__fish_mien_studio_using_subcommand nrsfm" -l rank -d 'Number of shape modes, 0 for a rigid reconstruction [default: chosen from the tracks]' -r
complete -c mien-studio -n "__fish_mien_studio_using_subcommand nrsfm" -l out -d '3F x P shapes to write' -r -F
complete -c mien-studio -n "__fish_mien_studio_using_subcommand nrsfm" -l truth -d '3F x P true shapes: prints the error, each frame rigidly aligned, one mirror for the whole sequence' -r -F
complete -c mien-studio -n "__fish_mien_studio_using_subcommand nrsfm" -s h -l help -d 'Print help'
complete -c mien-studio -n "__fish_mien_studio_using_subcommand bake" -l mesh -d 'Neutral head: OBJ (quads, texture coordinates and vertex order are kept), or GLB, glTF or VRM, whose copy in --out gets the shapes and keeps everything else' -r -F
complete -c mien-studio -n "__fish_mien_studio_using_subcommand bake" -l landmarks -d '68 vertex numbers from 0, one per line, in iBUG order; for a GLB, counted through its position accessors in order. auto finds them in a rendering of the mesh and writes beside --out a picture to check (.landmarks.png) and a file to correct and pass back in (.landmarks.txt)' -r -F
complete -c mien-studio -n "__fish_mien_studio_using_subcommand bake" -l out -d 'glTF with one morph target per shape (.glb, .vrm)' -r -F
complete -c mien-studio -n "__fish_mien_studio_using_subcommand bake" -l recipe -d 'Shapes and their control points [default: the 67 of config/blendshapes.toml]' -r -F
complete -c mien-studio -n "__fish_mien_studio_using_subcommand bake" -l controls -d 'CSV shape,vertex,dx,dy,dz in mesh units, instead of a recipe' -r -F
complete -c mien-studio -n "__fish_mien_studio_using_subcommand bake" -l obj -d 'Also neutral.obj, one OBJ per shape and shapes.json in this folder' -r -F
complete -c mien-studio -n "__fish_mien_studio_using_subcommand bake" -l report -d 'Pictures and figures of every shape, one HTML file' -r -F
complete -c mien-studio -n "__fish_mien_studio_using_subcommand bake" -l unit -d 'Unit of the mesh: mm, cm or m [default: from the distance of the eyes]' -r
complete -c mien-studio -n "__fish_mien_studio_using_subcommand bake" -l method -d 'aoi; for comparison paper, its Procedure 1 as printed, or laplacian, plain least squares' -r -f -a "aoi\t'AOI-constrained Laplacian deformation'
paper\t'The paper\'s Procedure 1 with its printed Laplacian, equations (10) to (13), on the whole skin'
laplacian\t'Plain Laplacian least squares, for comparison'"
complete -c mien-studio -n "__fish_mien_studio_using_subcommand bake" -l derive-controls -d 'With --controls: skin between the given vertices moves as learned from sculpted shapes; with a recipe it always does'
complete -c mien-studio -n "__fish_mien_studio_using_subcommand bake" -l correctives -d 'Also the recipe\'s correctives for pairs of shapes, named like jawOpen_mouthSmileLeft, to be weighted by the product of both weights, as animate does'
complete -c mien-studio -n "__fish_mien_studio_using_subcommand bake" -l dense -d 'Morph targets in full, for programs that cannot read sparse ones'
complete -c mien-studio -n "__fish_mien_studio_using_subcommand bake" -s h -l help -d 'Print help'
complete -c mien-studio -n "__fish_mien_studio_using_subcommand place" -l mesh -d 'Neutral head, as for bake' -r -F
complete -c mien-studio -n "__fish_mien_studio_using_subcommand place" -l landmarks -d 'Where to begin: 68 vertex numbers, as for bake, or auto: found on a picture of the mesh' -r -F
complete -c mien-studio -n "__fish_mien_studio_using_subcommand place" -l out -d 'What Save writes, for bake --landmarks [default: beside the mesh, NAME.landmarks.txt]' -r -F
complete -c mien-studio -n "__fish_mien_studio_using_subcommand place" -l port -d 'Where the page is served, on this machine only; 0 takes a free one' -r
complete -c mien-studio -n "__fish_mien_studio_using_subcommand place" -s h -l help -d 'Print help'
complete -c mien-studio -n "__fish_mien_studio_using_subcommand head" -l out -d 'The head to write, .glb or .obj' -r -F
complete -c mien-studio -n "__fish_mien_studio_using_subcommand head" -l make -d 'Rebuild the data that the program makes the head from' -r -F
complete -c mien-studio -n "__fish_mien_studio_using_subcommand head" -l data -d 'Folder of the data sets' -r -F
complete -c mien-studio -n "__fish_mien_studio_using_subcommand head" -s h -l help -d 'Print help'
complete -c mien-studio -n "__fish_mien_studio_using_subcommand preview" -l osc -d 'PORT or ADDRESS:PORT to receive OSC at; 0.0.0.0:9130 for a mien elsewhere' -r
complete -c mien-studio -n "__fish_mien_studio_using_subcommand preview" -l serial -d 'A serial port or tcp:host:port, any style' -r
complete -c mien-studio -n "__fish_mien_studio_using_subcommand preview" -l baud -d 'Baud rate of the serial port' -r
complete -c mien-studio -n "__fish_mien_studio_using_subcommand preview" -l full -d 'Value of a weight of 1, serial.full of the sender' -r
complete -c mien-studio -n "__fish_mien_studio_using_subcommand preview" -l csv -d 'What mien run --csv wrote, to play, pause and scrub; - for standard input' -r -F
complete -c mien-studio -n "__fish_mien_studio_using_subcommand preview" -l source -d 'A recording, kinect or simulated: followed here, with pictures' -r
complete -c mien-studio -n "__fish_mien_studio_using_subcommand preview" -l model -d 'Face model, with --source [default: the built-in one]' -r -F
complete -c mien-studio -n "__fish_mien_studio_using_subcommand preview" -l config -d 'Configuration file in which to save gains tried on the page' -r -F
complete -c mien-studio -n "__fish_mien_studio_using_subcommand preview" -l box -d 'ADDRESS:PORT where the box hears commands (osc.listen there) [default: the host that sends, port 9131]' -r
complete -c mien-studio -n "__fish_mien_studio_using_subcommand preview" -l mesh -d 'Heads with named morph targets (.glb) [default: a head of our own]' -r -F
complete -c mien-studio -n "__fish_mien_studio_using_subcommand preview" -l port -d 'Where the page is served, PORT or ADDRESS:PORT; 0 takes a free one' -r
complete -c mien-studio -n "__fish_mien_studio_using_subcommand preview" -s h -l help -d 'Print help'
complete -c mien-studio -n "__fish_mien_studio_using_subcommand skin" -l out -d 'The prior to write' -r -F
complete -c mien-studio -n "__fish_mien_studio_using_subcommand skin" -l data -d 'Folder of the data sets' -r -F
complete -c mien-studio -n "__fish_mien_studio_using_subcommand skin" -s h -l help -d 'Print help'
complete -c mien-studio -n "__fish_mien_studio_using_subcommand animate" -l mesh -d 'A head with named morph targets, as bake writes it' -r -F
complete -c mien-studio -n "__fish_mien_studio_using_subcommand animate" -l csv -d 'What mien run --csv wrote' -r -F
complete -c mien-studio -n "__fish_mien_studio_using_subcommand animate" -l out -d 'The head with the run as an animation, .glb or .vrm' -r -F
complete -c mien-studio -n "__fish_mien_studio_using_subcommand animate" -l user -d 'Slot to follow [default: the first that appears]' -r
complete -c mien-studio -n "__fish_mien_studio_using_subcommand animate" -s h -l help -d 'Print help'
complete -c mien-studio -n "__fish_mien_studio_using_subcommand help; and not __fish_seen_subcommand_from train fit inspect simulated-head record evaluate units nrsfm bake place head preview skin animate help" -f -a "train" -d 'Train the face model (shape, appearance, confidence) into one file; prints the error on held-out people'
complete -c mien-studio -n "__fish_mien_studio_using_subcommand help; and not __fish_seen_subcommand_from train fit inspect simulated-head record evaluate units nrsfm bake place head preview skin animate help" -f -a "fit" -d 'Fit landmarks to still pictures; reports the error if they are annotated'
complete -c mien-studio -n "__fish_mien_studio_using_subcommand help; and not __fish_seen_subcommand_from train fit inspect simulated-head record evaluate units nrsfm bake place head preview skin animate help" -f -a "inspect" -d 'Show a recording, a model, the CSV of a run or a mesh as pictures and plots; an HTML page plays the recording'
complete -c mien-studio -n "__fish_mien_studio_using_subcommand help; and not __fish_seen_subcommand_from train fit inspect simulated-head record evaluate units nrsfm bake place head preview skin animate help" -f -a "simulated-head" -d 'Rebuild the simulated sensor\'s built-in head from the training people'
complete -c mien-studio -n "__fish_mien_studio_using_subcommand help; and not __fish_seen_subcommand_from train fit inspect simulated-head record evaluate units nrsfm bake place head preview skin animate help" -f -a "record" -d 'Record from the sensor or the simulator'
complete -c mien-studio -n "__fish_mien_studio_using_subcommand help; and not __fish_seen_subcommand_from train fit inspect simulated-head record evaluate units nrsfm bake place head preview skin animate help" -f -a "evaluate" -d 'Run rendered sessions of held-out people through the whole pipeline and print one table'
complete -c mien-studio -n "__fish_mien_studio_using_subcommand help; and not __fish_seen_subcommand_from train fit inspect simulated-head record evaluate units nrsfm bake place head preview skin animate help" -f -a "units" -d 'Learn how each unit is computed from all measures together: [[feature]] and [[reading]] of config/units.toml'
complete -c mien-studio -n "__fish_mien_studio_using_subcommand help; and not __fish_seen_subcommand_from train fit inspect simulated-head record evaluate units nrsfm bake place head preview skin animate help" -f -a "nrsfm" -d 'Recover moving 3D shapes from 2D tracks; reports the error if the ground truth is given'
complete -c mien-studio -n "__fish_mien_studio_using_subcommand help; and not __fish_seen_subcommand_from train fit inspect simulated-head record evaluate units nrsfm bake place head preview skin animate help" -f -a "bake" -d 'Bake 67 blendshapes onto a neutral head'
complete -c mien-studio -n "__fish_mien_studio_using_subcommand help; and not __fish_seen_subcommand_from train fit inspect simulated-head record evaluate units nrsfm bake place head preview skin animate help" -f -a "place" -d 'Serve a web page for dragging the 68 landmarks into place on a neutral head, with a preview of the shapes'
complete -c mien-studio -n "__fish_mien_studio_using_subcommand help; and not __fish_seen_subcommand_from train fit inspect simulated-head record evaluate units nrsfm bake place head preview skin animate help" -f -a "head" -d 'Write a coloured head to experiment with, and its landmarks in a .txt beside it: baked with 67 shapes and a neck that stays still (.glb), or neutral with its materials (.obj)'
complete -c mien-studio -n "__fish_mien_studio_using_subcommand help; and not __fish_seen_subcommand_from train fit inspect simulated-head record evaluate units nrsfm bake place head preview skin animate help" -f -a "preview" -d 'Serve a web page: the animated head, the units, their ranges, curves, pose and state'
complete -c mien-studio -n "__fish_mien_studio_using_subcommand help; and not __fish_seen_subcommand_from train fit inspect simulated-head record evaluate units nrsfm bake place head preview skin animate help" -f -a "skin" -d 'Learn from sculpted shapes how skin moves, for bake'
complete -c mien-studio -n "__fish_mien_studio_using_subcommand help; and not __fish_seen_subcommand_from train fit inspect simulated-head record evaluate units nrsfm bake place head preview skin animate help" -f -a "animate" -d 'Export the weights of a run as a glTF animation'
complete -c mien-studio -n "__fish_mien_studio_using_subcommand help; and not __fish_seen_subcommand_from train fit inspect simulated-head record evaluate units nrsfm bake place head preview skin animate help" -f -a "help" -d 'Print this message or the help of the given subcommand(s)'
