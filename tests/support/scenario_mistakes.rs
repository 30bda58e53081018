//! Scenario texts, and the message for each mistake in them.

/// An arm, the base of most edits. It differs from the shipped one, so that the shipped one can be tuned without
/// changing these tests.
pub const ARM: &str = r#"# The arm with every table written out.
name = "arm"
seed = 1 # of all randomness
period_ms = 50
ticks = 2_000_000

[plant]
program = "tectum-simulator"

[plant.arm]
lengths = [0.5, 0.5, 0.5, 0.5]
base = [0.0, -1.0]
gain = 628.3185307179587
arena = [-1.0, 1.0]
target_every = 80
# targets = [[0.5, 0.0], [-0.5, 0.2]]

[plant.arm.reward]
scale = 0.1

# [[plant.arm.block]]

[encoder]
normalise = true

[[encoder.maps]]
inputs = ["target_x", "target_y"]
units = [16, 16]
radius = 0.5   # m
ranges = [[-1.0, 1.0], [-1.0, 1.0]]

[[encoder.maps]]
inputs = ["theta_1"]
radius = 0.5            # rad

[[encoder.maps]]
inputs = ["theta_2"]
radius = 0.5

[policy]
sigma = 0.003

[learner]
rule = "paper"
beta = 0.9
alpha_over_variance = 0.01

[gate]
max_command = 0.05
hold_ticks = 2

[log]
every = 20
hash_every = 1000

[channels]
observation = "observation"
command = "command"
learning = "learning"
"#;

/// A scenario of the eye.
pub const EYE: &str = r#"name = "eye"
ticks = 100

[plant]
program = "tectum-simulator"

[plant.eye]
retina = "log-polar"
distortion = 4.0
spread = 0.3
bonus = 0.5

[[encoder.maps]]
inputs = ["position_rho", "position_phi"]
radius = 0.5
"#;

/// A scenario of another plant program.
pub const OTHER: &str = r#"name = "lab"
ticks = 100

[plant]
program = "./rig"
inputs = [{ name = "angle", unit = "rad", min = -1, max = 1 }, { name = "speed", min = -2.0, max = 2.0 }]
outputs = [{ name = "torque", unit = "Nm", min = -0.1, max = 0.1 }]
measures = ["error"]

[[encoder.maps]]
inputs = ["angle", "speed"]
radius = 0.5
"#;

/// Base text, the replaced text, its replacement, and the message.
type Case = (&'static str, &'static str, &'static str, &'static str);

/// Every mistake with its message.
#[rustfmt::skip]
pub const CASES: &[Case] = &[
    (ARM, "name = \"arm\"", "name = arm",
        "x.toml:2: this is not valid TOML (string values must be quoted, expected literal string); correct it \
         here"),
    (ARM, "seed = 1", "seed = 1\nseed = 1",
        "x.toml:4: this is not valid TOML (duplicate key); correct it here"),
    (ARM, "seed = 1", "seed = 01",
        "x.toml:3: this is not valid TOML (unexpected leading zero); correct it here"),
    (ARM, "[plant]", "[plant",
        "x.toml:7: this is not valid TOML (unclosed table, expected `]`); correct it here"),
    (ARM, "hash_every = 1000", "hash_every =",
        "x.toml:54: this is not valid TOML (string values must be quoted, expected literal string); correct it \
         here"),
    (ARM, "seed = 1", "seed = 99999999999999999999",
        "x.toml:3: seed is 99999999999999999999; give a whole number from 0, written in digits only, such as \
         12_000_000"),
    (ARM, "period_ms", "perod_ms",
        "x.toml:4: unknown key \"perod_ms\"; did you mean \"period_ms\"?"),
    (ARM, "lengths = ", "lenghts = ",
        "x.toml:11: unknown key \"plant.arm.lenghts\"; did you mean \"plant.arm.lengths\"?"),
    (ARM, "sigma = ", "temperature = ",
        "x.toml:41: unknown key \"policy.temperature\"; the keys here are sigma and noise"),
    (ARM, "beta = ", "betta = ",
        "x.toml:45: unknown key \"learner.betta\"; did you mean \"learner.beta\"?"),
    (ARM, "radius = 0.5            # rad", "raduis = 0.5",
        "x.toml:34: unknown key \"encoder.maps[1].raduis\"; did you mean \"encoder.maps[1].radius\"?"),
    (ARM, "[gate]", "[gates]",
        "x.toml:48: unknown key \"gates\"; did you mean \"gate\"?"),
    (OTHER, "unit = \"rad\"", "units = \"rad\"",
        "x.toml:6: unknown key \"plant.inputs[0].units\"; did you mean \"plant.inputs[0].unit\"?"),
    (ARM, "seed = 1", "source = 1",
        "x.toml:3: unknown key \"source\"; the keys here are name, seed, period_ms, ticks, plant, controller, encoder, \
         policy, learner, gate, log, channels, restart, realtime, overrun, link and faults"),
    (EYE, "retina = \"log-polar\"", "\"a\\nb\" = \"log-polar\"",
        "x.toml:8: unknown key \"plant.eye.a\\nb\"; the keys here are retina, distortion, spread and bonus"),
    (ARM, "name = \"arm\"", "",
        "x.toml: name is missing; this key has no default, so add it"),
    (ARM, "ticks = 2_000_000", "",
        "x.toml: ticks is missing; this key has no default, so add it"),
    (OTHER, "radius = 0.5", "",
        "x.toml:10: encoder.maps[0].radius is missing; this key has no default, so add it"),
    (OTHER, ", max = 1 }", " }",
        "x.toml:6: plant.inputs[0].max is missing; this key has no default, so add it"),
    (ARM, "ticks = 2_000_000", "ticks = 2e6",
        "x.toml:5: ticks is 2000000.0; give a whole number from 0, written in digits only, such as 12_000_000"),
    (ARM, "ticks = 2_000_000", "ticks = -5",
        "x.toml:5: ticks is -5; give a whole number from 0, written in digits only, such as 12_000_000"),
    (ARM, "gain = 628.3185307179587", "gain = \"fast\"",
        "x.toml:13: plant.arm.gain is \"fast\"; give a number"),
    (ARM, "[plant.arm]", "[plant.emulator]\nnoise = -1.0\n[plant.arm]",
        "x.toml:11: plant.emulator.noise is -1; give 0 to 1000 steps"),
    (ARM, "[plant.arm]", "[plant.emulator]\nlatency = 5.0\n[plant.arm]",
        "x.toml:11: unknown key \"plant.emulator.latency\"; did you mean \"plant.emulator.latency_us\"?"),
    (ARM, "[plant.arm]", "[plant.emulator]\nspeed = 0.0\n[plant.arm]",
        "x.toml:11: plant.emulator.speed is 0; give 0.001 to 1e6, or leave it out if there is no limit"),
    (ARM, "[plant.arm]", "[[plant.emulator.faults]]\nkind = \"hot\"\n[plant.arm]",
        "x.toml:10: plant.emulator.faults[0] says neither how likely it is nor when; give probability, or from_s \
         and until_s, or all of them"),
    (ARM, "[plant.arm]", "[[plant.emulator.faults]]\nkind = \"slow\"\nfrom_s = 5.0\nuntil_s = 4.0\n[plant.arm]",
        "x.toml:13: plant.emulator.faults[0].until_s is 4; give more than from_s, which is 5"),
    (ARM, "normalise = true", "normalise = 1",
        "x.toml:24: encoder.normalise is 1; give true or false"),
    (ARM, "base = [0.0, -1.0]", "base = [0.0]",
        "x.toml:12: plant.arm.base is a list of 1; give a list of two numbers, such as [-1.0, 1.0]"),
    (ARM, "base = [0.0, -1.0]", "base = [0.0, -1.0, 0.0]",
        "x.toml:12: plant.arm.base is a list of 3; give a list of two numbers, such as [-1.0, 1.0]"),
    (ARM, "base = [0.0, -1.0]", "base = 0.0",
        "x.toml:12: plant.arm.base is 0.0; give a list of two numbers, such as [-1.0, 1.0]"),
    (ARM, "lengths = [0.5, 0.5, 0.5, 0.5]", "lengths = [0.5, true]",
        "x.toml:11: plant.arm.lengths[1] is true; give a number"),
    (ARM, "name = \"arm\"", "name = 5",
        "x.toml:2: name is 5; give a text in quotes"),
    (ARM, "rule = \"paper\"", "rule = \"papers\"",
        "x.toml:44: learner.rule is \"papers\"; give \"paper\", \"baseline\", \"actor-critic\", \
         \"natural-actor-critic\", \"learned-reward\" or \"model-predictive\""),
    (ARM, "rule = \"paper\"", "rule = \"model-predictive\"\nbudget_ms = 0",
        "x.toml:45: learner.budget_ms is 0; give 0.1 to 1000 ms"),
    (ARM, "rule = \"paper\"", "rule = \"model-predictive\"\nplan.horizon = 1",
        "x.toml:45: learner.plan.horizon is 1; give 2 to 200"),
    (ARM, "rule = \"paper\"", "rule = \"model-predictive\"\nplan.horizont = 9",
        "x.toml:45: unknown key \"learner.plan.horizont\"; did you mean \"learner.plan.horizon\"?"),
    (ARM, "rule = \"paper\"", "rule = 3",
        "x.toml:44: learner.rule is not a text; give one of its words in quotes"),
    (EYE, "retina = \"log-polar\"", "retina = \"polar\"",
        "x.toml:8: plant.eye.retina is \"polar\"; give \"linear\" or \"log-polar\""),
    (ARM, "units = [16, 16]", "units = 16",
        "x.toml:28: encoder.maps[0].units is 16; give a list, in [ ]"),
    (ARM, "units = [16, 16]", "units = [16, -16]",
        "x.toml:28: encoder.maps[0].units[1] is -16; give a whole number from 0, written in digits only, such as \
         12_000_000"),
    (ARM, "hold_ticks = 2", "hold_ticks = 5_000_000_000",
        "x.toml:50: gate.hold_ticks is 5000000000; give a whole number from 0, written in digits only, such as \
         12_000_000"),
    (ARM, "seed = 1", "seed = 2026-01-01",
        "x.toml:3: seed is a table or a date; give a whole number from 0, written in digits only, such as \
         12_000_000"),
    (OTHER, "ticks = 100", "ticks = 100\nlog = 3",
        "x.toml:3: log is 3; give a table of keys and values, under a single [heading] or in { }"),
    (OTHER, "ticks = 100", "ticks = 100\nlog = []",
        "x.toml:3: log is a list; give a table of keys and values, under a single [heading] or in { }"),
    (ARM, "[gate]", "[[gate]]",
        "x.toml:48: gate is a list; give a table of keys and values, under a single [heading] or in { }"),
    (OTHER, "{ name = \"speed\", min = -2.0, max = 2.0 }", "[\"speed\", \"\", -2.0, 2.0]",
        "x.toml:6: plant.inputs[1] is a list; give a table of keys and values, under a single [heading] or in { }"),
    (ARM, "arena = [-1.0, 1.0]", "arena = []",
        "x.toml:14: plant.arm.arena is a list of 0; give a list of two numbers, such as [-1.0, 1.0]"),
    (ARM, "arena = [-1.0, 1.0]", "arena = [\"low\", 1.0]",
        "x.toml:14: plant.arm.arena[0] is \"low\"; give a number"),
    (ARM, "ranges = [[-1.0, 1.0], [-1.0, 1.0]]", "ranges = [[-1.0, 1.0], [-1.0, 0.0, 1.0]]",
        "x.toml:30: encoder.maps[0].ranges[1] is a list of 3; give a list of two numbers, such as [-1.0, 1.0]"),
    (ARM, "ranges = [[-1.0, 1.0], [-1.0, 1.0]]", "ranges = [-1.0, 1.0]",
        "x.toml:30: encoder.maps[0].ranges[0] is -1.0; give a list of two numbers, such as [-1.0, 1.0]"),
    (ARM, "[policy]", "[policy]\n\"a.b\" = 1",
        "x.toml:41: unknown key \"policy.a.b\"; the keys here are sigma and noise"),
    (ARM, "[policy]", "[policy]\nsigma.x = 1\n[x]",
        "x.toml:41: policy.sigma is a table or a date; give a number"),
    (ARM, "name = \"arm\"", "\"\" = \"arm\"",
        "x.toml:2: unknown key \"\"; the keys here are name, seed, period_ms, ticks, plant, controller, encoder, \
         policy, learner, gate, log, channels, restart, realtime, overrun, link and faults"),
    (ARM, "name = \"arm\"", "name = \"\"",
        "x.toml:2: name is \"\"; give 1 to 32 characters out of letters, digits, - and _"),
    (ARM, "name = \"arm\"", "name = \"my arm\"",
        "x.toml:2: name is \"my arm\"; give 1 to 32 characters out of letters, digits, - and _"),
    (ARM, "name = \"arm\"", "name = \"a123456789012345678901234567890123\"",
        "x.toml:2: name is \"a123456789012345678901234567890123\"; give 1 to 32 characters out of letters, digits, \
         - and _"),
    (ARM, "period_ms = 50", "period_ms = 0.5",
        "x.toml:4: period_ms is 0.5; give 1 to 1000 ms"),
    (ARM, "period_ms = 50", "period_ms = nan",
        "x.toml:4: period_ms is nan; give 1 to 1000 ms"),
    (ARM, "period_ms = 50", "period_ms = 16.66666667",
        "x.toml:4: period_ms is 16.66666667; give at most six decimals, so that it is a whole number of ns"),
    (ARM, "ticks = 2_000_000", "ticks = 1",
        "x.toml:5: ticks is 1; give 2 to 1000000000000 ticks"),
    (ARM, "ticks = 2_000_000", "ticks = 1_000_000_000_001",
        "x.toml:5: ticks is 1000000000001; give 2 to 1000000000000 ticks"),
    (ARM, "\"tectum-simulator\"", "\" \"",
        "x.toml:8: plant.program is \" \"; give the name or the path of a program"),
    (ARM, "\"tectum-simulator\"", "\"rig\\u0000\"",
        "x.toml:8: plant.program is \"rig\\0\"; give at most 4096 characters, none of them a zero character"),
    (ARM, "program = \"tectum-simulator\"", "args = [\"a\", \"b\\u0000\"]",
        "x.toml:8: plant.args[1] is \"b\\0\"; give at most 4096 characters, none of them a zero character"),
    (ARM, "[policy]", "[controller]\nprogram = \"\"\n\n[policy]",
        "x.toml:41: controller.program is \"\"; give the name or the path of a program"),
    (ARM, "[policy]", "[controller]\nargs = [\"\\u0000\"]\n\n[policy]",
        "x.toml:41: controller.args[0] is \"\\0\"; give at most 4096 characters, none of them a zero character"),
    (OTHER, "\"./rig\"", "\"/opt/tectum-simulator\"",
        "x.toml:4: plant has nothing to simulate; add [plant.arm], [plant.eye], [plant.pendulum], [plant.cart-pole], \
         [plant.reacher], [plant.furuta], [plant.point-mass] or [plant.so101]"),
    (ARM, "[plant.arm]", "[plant.pendulum]\n[plant.arm]",
        "x.toml:10: plant.pendulum stands beside plant.arm; keep one of the two"),
    (ARM, "[plant.arm]", "[plant.timing]\ndelay = 11\n[plant.arm]",
        "x.toml:11: plant.timing.delay is 11; give 0 to 10 ticks"),
    (ARM, "[plant.arm]", "[plant.eye]\n[plant.arm]",
        "x.toml:10: plant.eye stands beside plant.arm; keep one of the two"),
    (ARM, "[plant.arm]", "measures = [\"error\"]\n[plant.arm]",
        "x.toml:10: plant.measures is given, but tectum-simulator knows its own; take it out"),
    (EYE, "\"tectum-simulator\"", "\"./rig\"",
        "x.toml:7: plant.eye belongs to tectum-simulator and plant.program is \"./rig\"; take one of the two out"),
    (OTHER, "inputs = [{ name = \"angle\", unit = \"rad\", min = -1, max = 1 }, { name = \"speed\", min = -2.0, \
         max = 2.0 }]", "",
        "x.toml:4: plant.inputs is empty; a program other than tectum-simulator lists its inputs and outputs"),
    (OTHER, "outputs = [{ name = \"torque\", unit = \"Nm\", min = -0.1, max = 0.1 }]", "outputs = []",
        "x.toml:7: plant.outputs is empty; a program other than tectum-simulator lists its inputs and outputs"),
    (OTHER, "measures = [\"error\"]", "measures = [\"a\", \"b\", \"c\", \"d\", \"e\", \"f\", \"g\"]",
        "x.toml:8: plant.measures has 7 entries; give at most 6"),
    (OTHER, "measures = [\"error\"]",
        "measures = [{ name = \"a\", role = \"error\" }, { name = \"b\", role = \"error\" }]",
        "x.toml:8: plant.measures has two entries with the role error; give it to one"),
    (OTHER, "radius = 0.5", "radius = [0.5]",
        "x.toml:12: encoder.maps[0].radius has length 1 and inputs has length 2; give one for each input, or one \
         number for all"),
    (OTHER, "radius = 0.5", "radius = [0.5, 0]",
        "x.toml:12: encoder.maps[0].radius[1] is 0; give more than 0 (1e-9 or more), up to 1e9"),
    (OTHER, "measures = [\"error\"]", "measures = [\"a\", \"a\"]",
        "x.toml:8: plant.measures[1] is \"a\"; this name is in the list already, and each may occur once"),
    (OTHER, "measures = [\"error\"]", "measures = [\"\"]",
        "x.toml:8: plant.measures[0] is \"\"; give 1 to 32 characters out of letters, digits, _, -, . and /"),
    (OTHER, "\"speed\", min", "\"angle\", min",
        "x.toml:6: plant.inputs[1].name is \"angle\"; this name is in the list already, and each may occur once"),
    (OTHER, "\"speed\", min", "\"forward speed\", min",
        "x.toml:6: plant.inputs[1].name is \"forward speed\"; give 1 to 32 characters out of letters, digits, _, \
         -, . and /"),
    (OTHER, "unit = \"Nm\"", "unit = \"N\\tm\"",
        "x.toml:7: plant.outputs[0].unit is \"N\\tm\"; give at most 32 characters, none of them a control \
         character"),
    (OTHER, "min = -1,", "min = 1,",
        "x.toml:6: plant.inputs[0].max is 1; give more than min, which is 1"),
    (OTHER, "min = -1,", "min = -inf,",
        "x.toml:6: plant.inputs[0].min is -inf; give a number from -1e9 to 1e9"),
    (OTHER, "max = 2.0", "max = 1e300",
        "x.toml:6: plant.inputs[1].max is 1e300; give a number from -1e9 to 1e9"),
    (ARM, "lengths = [0.5, 0.5, 0.5, 0.5]", "lengths = []",
        "x.toml:11: plant.arm.lengths has 0 entries; give 1 to 8 lengths"),
    (ARM, "lengths = [0.5, 0.5, 0.5, 0.5]", "lengths = [1, 1, 1, 1, 1, 1, 1, 1, 1]",
        "x.toml:11: plant.arm.lengths has 9 entries; give 1 to 8 lengths"),
    (ARM, "lengths = [0.5, 0.5, 0.5, 0.5]", "lengths = [0.5, 0.5, -0.5, 0.5]",
        "x.toml:11: plant.arm.lengths[2] is -0.5; give 0.001 to 100 m"),
    (ARM, "base = [0.0, -1.0]", "base = [0.0, inf]",
        "x.toml:12: plant.arm.base[1] is inf; give -1000 to 1000 m"),
    (ARM, "gain = 628.3185307179587", "gain = 0",
        "x.toml:13: plant.arm.gain is 0; give a rate other than 0, from -1e6 to 1e6 rad/s"),
    (ARM, "gain = 628.3185307179587", "gain = nan",
        "x.toml:13: plant.arm.gain is nan; give a rate other than 0, from -1e6 to 1e6 rad/s"),
    (ARM, "arena = [-1.0, 1.0]", "arena = [1.0, -1.0]",
        "x.toml:14: plant.arm.arena is [1, -1]; give the lower end and then the upper one, between -1000 and 1000"),
    (ARM, "arena = [-1.0, 1.0]", "arena = [5.0, 6.0]",
        "x.toml:14: plant.arm.arena is [5, 6]; the arm can reach less than 1 % of it, so that no targets can be \
         drawn; change arena, base or lengths, or give targets"),
    (ARM, "target_every = 80", "target_every = 0",
        "x.toml:15: plant.arm.target_every is 0; give 1 to 1000000000000 ticks"),
    (ARM, "# targets = [[0.5, 0.0], [-0.5, 0.2]]", "targets = [[0.5, 0.0], [-0.5, 1.2]]",
        "x.toml:16: plant.arm.targets[1] is [-0.5, 1.2]; targets lie in plant.arm.arena, from -1 to 1 m on both \
         axes"),
    (ARM, "# targets = [[0.5, 0.0], [-0.5, 0.2]]", "targets = [[0.5, nan]]",
        "x.toml:16: plant.arm.targets[0] is [0.5, nan]; targets lie in plant.arm.arena, from -1 to 1 m on both \
         axes"),
    (ARM, "scale = 0.1", "scale = -0.1",
        "x.toml:19: plant.arm.reward.scale is -0.1; give 0 to 1e6"),
    (ARM, "# [[plant.arm.block]]", "[[plant.arm.block]]\njoint = 5\ntick = 10",
        "x.toml:22: plant.arm.block[0].joint is 5; the arm's joints are 1 to 4, counted from the base"),
    (ARM, "# [[plant.arm.block]]", "[[plant.arm.block]]\njoint = 0\ntick = 10",
        "x.toml:22: plant.arm.block[0].joint is 0; the arm's joints are 1 to 4, counted from the base"),
    (ARM, "# [[plant.arm.block]]", "[[plant.arm.block]]\njoint = 3\ntick = 2_000_000_000_000",
        "x.toml:23: plant.arm.block[0].tick is 2000000000000; give 0 to 1000000000000 ticks"),
    (ARM, "# [[plant.arm.block]]", "[[plant.arm.block]]\njoint = 3\ntick = 10\nangle = 4.0",
        "x.toml:24: plant.arm.block[0].angle is 4; give -pi to pi rad"),
    (ARM, "# [[plant.arm.block]]",
        "[[plant.arm.block]]\njoint = 3\ntick = 10\n[[plant.arm.block]]\njoint = 3\ntick = 10",
        "x.toml:24: plant.arm.block[1] blocks joint 3 at tick 10 once more; keep one of the two"),
    (ARM, "base = [0.0, -1.0]", "angles = \"joint\"",
        "x.toml:12: plant.arm.angles is \"joint\"; give \"absolute\" or \"relative\""),
    (ARM, "base = [0.0, -1.0]", "limits = [[-1, 1], [-1, 1]]",
        "x.toml:12: plant.arm.limits has 2 entries and the arm has 4 joints; give one for each, or leave it out if \
         they turn freely"),
    (ARM, "base = [0.0, -1.0]", "limits = [[-1, 1], [-1, 1], [0.5, 1], [-1, 1]]",
        "x.toml:12: plant.arm.limits[2] is [0.5, 1]; give the least and then the greatest angle, from -pi to pi \
         rad, with the starting angle 0 between them"),
    (ARM, "base = [0.0, -1.0]", "limits = [[-1, 1], [-1, 1], [-1, 1], [-1, 4]]",
        "x.toml:12: plant.arm.limits[3] is [-1, 4]; give the least and then the greatest angle, from -pi to pi \
         rad, with the starting angle 0 between them"),
    (ARM, "base = [0.0, -1.0]", "limits = [[-1, 1], [-1, 1], [-1, 1], [-3.141592653589793, 3.141592653589793]]",
        "x.toml:12: plant.arm.limits[3] is [-3.141592653589793, 3.141592653589793]; a limited joint has less than \
         a full turn, at most 6.25 rad; leave limits out if joints turn freely"),
    (ARM, "base = [0.0, -1.0]", "hidden_limits = true",
        "x.toml:12: plant.arm.hidden_limits is true, and there are no limits to hide; give limits, or leave it out"),
    (ARM, "base = [0.0, -1.0]", "limits = [[-1, 1, 2]]",
        "x.toml:12: plant.arm.limits[0] is a list of 3; give a list of two numbers, such as [-1.0, 1.0]"),
    (ARM, "base = [0.0, -1.0]", "open_loop = true",
        "x.toml:15: plant.arm.target_every is 80; an open loop has a new target every tick, so give 1"),
    (ARM, "base = [0.0, -1.0]",
        "limits = [[-1, 1], [-1, 1], [-1, 1], [-1, 1]]\nblock = [{ joint = 2, tick = 10, angle = 1.5 }]",
        "x.toml:13: plant.arm.block[0].angle is 1.5; the joint's limits are -1 and 1 rad"),
    (ARM, "scale = 0.1", "near = 0",
        "x.toml:19: plant.arm.reward.near is 0; give 0.001 to 100 m, or leave it out"),
    (ARM, "scale = 0.1", "collision = -1",
        "x.toml:19: plant.arm.reward.collision is -1; give 0 to 1e6"),
    (ARM, "# [[plant.arm.block]]", "[[plant.arm.shorten]]\nsegment = 5\ntick = 10\nlength = 0.3",
        "x.toml:22: plant.arm.shorten[0].segment is 5; the arm's segments are 1 to 4, counted from the base"),
    (ARM, "# [[plant.arm.block]]", "[[plant.arm.shorten]]\nsegment = 2\ntick = 10\nlength = 0",
        "x.toml:24: plant.arm.shorten[0].length is 0; give 0.001 to 100 m"),
    (ARM, "# [[plant.arm.block]]", "[[plant.arm.shorten]]\nsegment = 2\ntick = 10\nlength = 100",
        "x.toml:24: plant.arm.shorten[0].length is 100; from then on the arm can reach less than 1 % of \
         plant.arm.arena, so that no targets can be drawn; give another length, or targets"),
    (ARM, "# [[plant.arm.block]]",
        "[[plant.arm.shorten]]\nsegment = 2\ntick = 10\nlength = 0.3\n[[plant.arm.shorten]]\nsegment = 2\ntick = \
         10\nlength = 0.4",
        "x.toml:25: plant.arm.shorten[1] changes segment 2 at tick 10 once more; keep one of the two"),
    (ARM, "# [[plant.arm.block]]", "[[plant.arm.mirror]]\naxis = \"z\"\ntick = 10",
        "x.toml:22: plant.arm.mirror[0].axis is \"z\"; give \"x\" or \"y\""),
    (ARM, "# [[plant.arm.block]]", "[[plant.arm.mirror]]\naxis = \"x\"",
        "x.toml:21: plant.arm.mirror[0].tick is missing; this key has no default, so add it"),
    (ARM, "base = [0.0, -1.0]", "mirror = [[\"x\", 10]]",
        "x.toml:12: plant.arm.mirror[0] is a list; give a table of keys and values, under a single [heading] or in \
         { }"),
    (ARM, "# [[plant.arm.block]]",
        "[[plant.arm.mirror]]\naxis = \"x\"\ntick = 10\n[[plant.arm.mirror]]\naxis = \"x\"\ntick = 10",
        "x.toml:24: plant.arm.mirror[1] turns the same axis at tick 10 once more; keep one of the two"),
    (ARM, "sigma = 0.003", "noise = \"uniform\"",
        "x.toml:41: policy.noise is \"uniform\"; give \"gaussian\" or \"laplace\""),
    (EYE, "distortion = 4.0", "distortion = 0",
        "x.toml:9: plant.eye.distortion is 0; give 0.001 to 1e6"),
    (EYE, "spread = 0.3", "spread = inf",
        "x.toml:10: plant.eye.spread is inf; give 1e-6 to 10, in retina coordinates"),
    (EYE, "bonus = 0.5", "bonus = 2000",
        "x.toml:11: plant.eye.bonus is 2000; give -1000 to 1000"),
    (OTHER, "[[encoder.maps]]\ninputs = [\"angle\", \"speed\"]\nradius = 0.5", "[encoder]\nmaps = []",
        "x.toml:11: encoder.maps has 0 maps; give 1 to 64"),
    (OTHER, "inputs = [\"angle\", \"speed\"]", "inputs = []",
        "x.toml:11: encoder.maps[0].inputs has 0 entries; a map has 1 or 2 inputs"),
    (OTHER, "inputs = [\"angle\", \"speed\"]", "inputs = [\"angle\", \"speed\", \"angle\"]",
        "x.toml:11: encoder.maps[0].inputs has 3 entries; a map has 1 or 2 inputs"),
    (ARM, "inputs = [\"theta_2\"]", "inputs = [\"theta_5\"]",
        "x.toml:37: encoder.maps[2].inputs[0] is \"theta_5\"; the plant's inputs are target_x, target_y, theta_1, \
         theta_2, theta_3 and theta_4"),
    (OTHER, "inputs = [\"angle\", \"speed\"]", "inputs = [\"angle\", \"angle\"]",
        "x.toml:11: encoder.maps[0].inputs[1] is \"angle\"; this name is in the list already, and each may occur \
         once"),
    (ARM, "units = [16, 16]", "units = [16]",
        "x.toml:28: encoder.maps[0].units has length 1 and inputs has length 2; give one for each input, or leave \
         it out"),
    (ARM, "ranges = [[-1.0, 1.0], [-1.0, 1.0]]", "ranges = [[-1.0, 1.0]]",
        "x.toml:30: encoder.maps[0].ranges has length 1 and inputs has length 2; give one for each input, or leave \
         it out"),
    (ARM, "units = [16, 16]", "units = [16, 1_000_000]",
        "x.toml:28: encoder.maps[0].units[1] is 1000000; a map may have 2 to 4096 units along an input"),
    (ARM, "units = [16, 16]", "units = [1, 16]",
        "x.toml:28: encoder.maps[0].units[0] is 1; a map may have 2 to 4096 units along an input"),
    (ARM, "units = [16, 16]", "units = [256, 256]",
        "x.toml:26: encoder.maps has 65568 units in all; give at most 65536"),
    (ARM, "ranges = [[-1.0, 1.0], [-1.0, 1.0]]", "ranges = [[-1.0, 1.0], [1.0, 1.0]]",
        "x.toml:30: encoder.maps[0].ranges[1] is [1, 1]; give the lower end and then the upper one, between \
         -1000000000 and 1000000000"),
    (ARM, "radius = 0.5   ", "radius = 0   ",
        "x.toml:29: encoder.maps[0].radius is 0; give more than 0 (1e-9 or more), up to 1e9"),
    (ARM, "radius = 0.5   ", "radius = 0.01   ",
        "x.toml:29: encoder.maps[0].radius is 0.01; the units along target_x are about 0.133 apart, so that inputs \
         between them would hardly activate any; give a radius of at least a tenth of that, or more units"),
    (ARM, "sigma = 0.003", "sigma = 0",
        "x.toml:41: policy.sigma is 0; give more than 0 (1e-9 or more), up to gate.max_command, which is 0.05"),
    (ARM, "sigma = 0.003", "sigma = 0.06",
        "x.toml:41: policy.sigma is 0.06; give more than 0 (1e-9 or more), up to gate.max_command, which is 0.05"),
    (ARM, "beta = 0.9", "beta = 1",
        "x.toml:45: learner.beta is 1; give at least 0 and less than 1"),
    (ARM, "alpha_over_variance = 0.01", "alpha_over_variance = -0.01",
        "x.toml:46: learner.alpha_over_variance is -0.01; give 0 to 1000"),
    (ARM, "max_command = 0.05", "max_command = nan",
        "x.toml:49: gate.max_command is nan; give more than 0 (1e-9 or more), up to 1e6"),
    (ARM, "hold_ticks = 2", "hold_ticks = 1_000_001",
        "x.toml:50: gate.hold_ticks is 1000001; give 0 to 1000000 ticks"),
    (ARM, "max_command = 0.05", "max_command = \"small\"",
        "x.toml:49: gate.max_command is \"small\"; give a number, or a list of numbers, one for each output"),
    (ARM, "max_command = 0.05", "max_command = [0.05, true]",
        "x.toml:49: gate.max_command[1] is true; give a number"),
    (ARM, "max_command = 0.05", "max_command = [0.05, 0.05, 0, 0.05]",
        "x.toml:49: gate.max_command[2] is 0; give more than 0 (1e-9 or more), up to 1e6"),
    (ARM, "max_command = 0.05", "max_command = [0.05, 0.05]",
        "x.toml:49: gate.max_command has 2 entries; give one for each output: rate_1, rate_2, rate_3, rate_4"),
    (ARM, "max_command = 0.05", "max_command = []",
        "x.toml:49: gate.max_command has 0 entries; give one for each output: rate_1, rate_2, rate_3, rate_4"),
    (ARM, "max_command = 0.05", "max_command = [0.05, 0.002, 0.05, 0.05]",
        "x.toml:41: policy.sigma is 0.003; give more than 0 (1e-9 or more), up to gate.max_command, which is \
         0.002"),
    (ARM, "hold_ticks = 2", "max_step = -0.01",
        "x.toml:50: gate.max_step is -0.01; give more than 0 (1e-9 or more), up to 1e6"),
    (ARM, "hold_ticks = 2", "max_step = [0.01]",
        "x.toml:50: gate.max_step has 1 entries; give one for each output: rate_1, rate_2, rate_3, rate_4"),
    (ARM, "hold_ticks = 2", "ramp_ticks = 1_000_001",
        "x.toml:50: gate.ramp_ticks is 1000001; give 0 to 1000000 ticks"),
    (ARM, "hold_ticks = 2", "positions = [[-1, 1], [-1, 1], [1, -1], [-1, 1]]",
        "x.toml:50: gate.positions[2] is [1, -1]; give the least and then the greatest angle, from -1000 to 1000 \
         rad and at least 0.001 apart"),
    (ARM, "hold_ticks = 2", "positions = [[-1, nan]]",
        "x.toml:50: gate.positions[0] is [-1, nan]; give the least and then the greatest angle, from -1000 to 1000 \
         rad and at least 0.001 apart"),
    (ARM, "hold_ticks = 2", "positions = [[-1, 1], [-1, 1]]",
        "x.toml:50: gate.positions has 2 entries; give one for each output: rate_1, rate_2, rate_3, rate_4"),
    (ARM, "hold_ticks = 2", "positions = [-1, 1]",
        "x.toml:50: gate.positions[0] is -1; give a list of two numbers, such as [-1.0, 1.0]"),
    (EYE, "bonus = 0.5", "[gate]\npositions = [[-1, 1], [-1, 1], [-1, 1], [-1, 1]]",
        "x.toml:12: gate.positions is given, and the eye has no joints whose positions could be limited; take it \
         out"),
    (ARM, "[log]", "[overrun]\nmax_consecutive = 1_000_000_000_001\n[log]",
        "x.toml:53: overrun.max_consecutive is 1000000000001; give 0 to 1000000000000 ticks; 0 never ends a run"),
    (ARM, "[log]", "[overrun]\nmax = 3\n[log]",
        "x.toml:53: unknown key \"overrun.max\"; the only key here is max_consecutive"),
    (ARM, "[log]", "[faults]\nchannels = []\n[log]",
        "x.toml:53: unknown key \"faults.channels\"; did you mean \"faults.channel\"?"),
    (ARM, "[log]", "[faults.channel]\nkind = \"drop\"\n[log]",
        "x.toml:52: faults.channel is a table or a date; give a list, in [ ]"),
    (ARM, "[log]", "[faults]\nchannel = [[\"command\", \"drop\"]]\n[log]",
        "x.toml:53: faults.channel[0] is a list; give a table of keys and values, under a single [heading] or in { \
         }"),
    (ARM, "[log]", "[[faults.channel]]\nchannel = \"command\"\nkind = \"drop\"\n[log]",
        "x.toml:52: faults.channel[0] says neither how likely it is nor when; give probability, or from and until, \
         or all of them"),
    (ARM, "[log]", "[[faults.channel]]\nkind = \"drop\"\n[log]",
        "x.toml:52: faults.channel[0].channel is missing; this key has no default, so add it"),
    (ARM, "[log]", "[[faults.channel]]\nchannel = \"wire\"\n[log]",
        "x.toml:53: faults.channel[0].channel is \"wire\"; give \"observation\", \"command\" or \"learning\""),
    (ARM, "[log]",
        "[[faults.channel]]\nchannel = \"learning\"\nkind = \"corrupt\"\nvalue = \"nan\"\nprobability = 0.1\n[log]",
        "x.toml:54: faults.channel[0].kind is corrupt, on the channel learning; the log would \
         contain false records, so give another kind or another channel"),
    (ARM, "[log]", "[[faults.channel]]\nchannel = \"command\"\nkind = \"lose\"\n[log]",
        "x.toml:54: faults.channel[0].kind is \"lose\"; give \"delay\", \"drop\", \"duplicate\", \"reorder\", \
         \"freeze\" or \"corrupt\""),
    (ARM, "[log]", "[[faults.channel]]\nchannel = \"command\"\nkind = \"drop\"\nprobability = 1.5\n[log]",
        "x.toml:55: faults.channel[0].probability is 1.5; give more than 0, up to 1"),
    (ARM, "[log]", "[[faults.channel]]\nchannel = \"command\"\nkind = \"drop\"\nprobability = nan\n[log]",
        "x.toml:55: faults.channel[0].probability is nan; give more than 0, up to 1"),
    (ARM, "[log]", "[[faults.channel]]\nchannel = \"command\"\nkind = \"drop\"\nfrom = 10\nuntil = 10\n[log]",
        "x.toml:56: faults.channel[0].until is 10; give more than from, which is 10: it is the first tick without \
         the fault"),
    (ARM, "[log]", "[[faults.channel]]\nchannel = \"command\"\nkind = \"drop\"\nfrom = 10\nticks = 3\n[log]",
        "x.toml:56: faults.channel[0].ticks is given, and drop takes none; it belongs to delay, duplicate and \
         freeze"),
    (ARM, "[log]", "[[faults.channel]]\nchannel = \"command\"\nkind = \"delay\"\nfrom = 10\nticks = 17\n[log]",
        "x.toml:56: faults.channel[0].ticks is 17; give 1 to 16 ticks"),
    (ARM, "[log]", "[[faults.channel]]\nchannel = \"command\"\nkind = \"freeze\"\nfrom = 10\nticks = 0\n[log]",
        "x.toml:56: faults.channel[0].ticks is 0; give 1 to 1000000 ticks"),
    (ARM, "[log]", "[[faults.channel]]\nchannel = \"command\"\nkind = \"corrupt\"\nfrom = 10\n[log]",
        "x.toml:52: faults.channel[0] does not say what corrupt puts in place of a value; give value = \"nan\" or \
         \"huge\""),
    (ARM, "[log]", "[[faults.channel]]\nchannel = \"command\"\nkind = \"drop\"\nfrom = 10\nvalue = \"nan\"\n[log]",
        "x.toml:56: faults.channel[0].value is given, and drop takes none; it belongs to corrupt"),
    (ARM, "[log]", "[[faults.process]]\nprocess = \"launcher\"\n[log]",
        "x.toml:53: faults.process[0].process is \"launcher\"; give \"plant\", \"controller\" or \"logger\""),
    (ARM, "[log]", "[[faults.process]]\nprocess = \"logger\"\ndo = \"pause\"\n[log]",
        "x.toml:54: faults.process[0].do is \"pause\"; give \"kill\", \"stop\" or \"restart\""),
    (ARM, "[log]", "[[faults.process]]\nprocess = \"logger\"\ndo = \"kill\"\nat = []\n[log]",
        "x.toml:55: faults.process[0].at has 0 entries; give 1 to 1000 ticks"),
    (ARM, "[log]", "[[faults.process]]\nprocess = \"logger\"\ndo = \"kill\"\nat = [10, 10]\n[log]",
        "x.toml:55: faults.process[0].at[1] is 10; give ticks in rising order; the one before is 10"),
    (ARM, "[log]", "[[faults.process]]\nprocess = \"logger\"\ndo = \"stop\"\nat = [10]\n[log]",
        "x.toml:52: faults.process[0] does not say for how long the process is stopped; give for_ms, 1 to 60000"),
    (ARM, "[log]", "[[faults.process]]\nprocess = \"logger\"\ndo = \"stop\"\nat = [10]\nfor_ms = 0\n[log]",
        "x.toml:56: faults.process[0].for_ms is 0; give 1 to 60000 ms"),
    (ARM, "[log]", "[[faults.process]]\nprocess = \"logger\"\ndo = \"kill\"\nat = [10]\nfor_ms = 5\n[log]",
        "x.toml:56: faults.process[0].for_ms is given, and kill takes no time; it belongs to stop"),
    (ARM, "every = 20", "every = 0",
        "x.toml:53: log.every is 0; give 1 to 1000000000000 ticks"),
    (ARM, "hash_every = 1000", "hash_every = 0",
        "x.toml:54: log.hash_every is 0; give 1 to 1000000000000 ticks"),
    (ARM, "command = \"command\"", "command = \"observation\"",
        "x.toml:58: channels.command and channels.observation are both \"observation\"; give each channel a name \
         of its own"),
    (ARM, "command = \"command\"", "command = \"Command\"",
        "x.toml:58: channels.command is \"Command\"; give 1 to 64 characters out of lower-case letters, digits, _, \
         - and /"),
    (ARM, "learning = \"learning\"", "learning = \"\"",
        "x.toml:59: channels.learning is \"\"; give 1 to 64 characters out of lower-case letters, digits, _, - and \
         /"),
];
