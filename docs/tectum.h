/* Samples and boards of a Tectum run, for C and C++. docs/wire.md describes their use.
 *
 * Made from the field tables of the Rust processes by tests/wire.rs; do not edit. Little endian, IEEE 754, no
 * padding. The constants that begin with TECTUM_TYPE_ are the payloads' type names, which iceoryx2 compares. */
#ifndef TECTUM_H
#define TECTUM_H

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
#define TECTUM_ASSERT(what) static_assert(what, #what)
#else
#define TECTUM_ASSERT(what) _Static_assert(what, #what)
#endif

#define TECTUM_MAX_INPUTS 32
#define TECTUM_MAX_OUTPUTS 16
#define TECTUM_MAX_MEASURES 6
#define TECTUM_MAX_COLUMNS 8
#define TECTUM_MAX_AHEAD 8

/* The start of every sample: its writer, its tick and its instants. */
typedef struct tectum_header {
    /* Id of the run, the same in all its processes. */
    uint64_t run;
    /* The tick that the sample belongs to. */
    uint64_t tick;
    /* Counts the samples of this channel from 0. A gap is a loss, and a repeated number is a duplicate. */
    uint64_t sequence;
    /* The instant for which the tick was scheduled, `t0 + tick * period`, ns. */
    uint64_t scheduled_ns;
    /* The instant at which the plant had sensed the observation of this tick, ns. */
    uint64_t sensed_ns;
    /* The instant at which the writer sent the sample, ns. */
    uint64_t published_ns;
    /* The writer's start number within the run, from 0. */
    uint32_t incarnation;
    /* Bits of `flag`. */
    uint32_t flags;
} tectum_header;
#define TECTUM_TYPE_HEADER "tectum.Header.v1"
TECTUM_ASSERT(sizeof(tectum_header) == 56);
TECTUM_ASSERT(offsetof(tectum_header, run) == 0);
TECTUM_ASSERT(offsetof(tectum_header, tick) == 8);
TECTUM_ASSERT(offsetof(tectum_header, sequence) == 16);
TECTUM_ASSERT(offsetof(tectum_header, scheduled_ns) == 24);
TECTUM_ASSERT(offsetof(tectum_header, sensed_ns) == 32);
TECTUM_ASSERT(offsetof(tectum_header, published_ns) == 40);
TECTUM_ASSERT(offsetof(tectum_header, incarnation) == 48);
TECTUM_ASSERT(offsetof(tectum_header, flags) == 52);

/* The plant's sample at tick k: the current inputs, and the result of tick k-1. */
typedef struct tectum_observation {
    /* Writer, tick and instants. */
    tectum_header header;
    /* The controller's inputs, in the scenario's order and units; unused entries are 0. */
    float inputs[32];
    /* The command that was applied during tick k-1, after hold policy and gate; unused entries are 0. */
    float applied[16];
    /* The reward of tick k-1. */
    float reward;
    /* Ticks skipped right before this one because the plant itself was late. */
    uint32_t skipped;
    /* Measures of tick k-1, named by the scenario. They are for logs and reports; the learner never receives them.
     * The arm gives its error (m) and its end-effector's x and y (m). */
    float measures[6];
} tectum_observation;
#define TECTUM_TYPE_OBSERVATION "tectum.Observation.v2"
TECTUM_ASSERT(sizeof(tectum_observation) == 280);
TECTUM_ASSERT(offsetof(tectum_observation, header) == 0);
TECTUM_ASSERT(offsetof(tectum_observation, inputs) == 56);
TECTUM_ASSERT(offsetof(tectum_observation, applied) == 184);
TECTUM_ASSERT(offsetof(tectum_observation, reward) == 248);
TECTUM_ASSERT(offsetof(tectum_observation, skipped) == 252);
TECTUM_ASSERT(offsetof(tectum_observation, measures) == 256);

/* The controller's answer to the observation of the same tick. */
typedef struct tectum_command {
    /* Writer, tick and instants. */
    tectum_header header;
    /* The policy's mean output. */
    float mean[16];
    /* The drawn output: mean plus exploration noise. This is the command for the plant. */
    float drawn[16];
} tectum_command;
#define TECTUM_TYPE_COMMAND "tectum.Command.v2"
TECTUM_ASSERT(sizeof(tectum_command) == 184);
TECTUM_ASSERT(offsetof(tectum_command, header) == 0);
TECTUM_ASSERT(offsetof(tectum_command, mean) == 56);
TECTUM_ASSERT(offsetof(tectum_command, drawn) == 120);

/* What goes with a command where the scenario has `[link] ahead`: commands without exploration noise for the ticks
 * after it. It is sent just before the command. */
typedef struct tectum_ahead {
    /* As that of the command; `flags` is 0. */
    tectum_header header;
    /* Number of ticks that there is a command for: those after the header's. */
    uint64_t ticks;
    /* Their commands, one tick after the other, each as `drawn` of a command; unused entries are 0. */
    float commands[128];
} tectum_ahead;
#define TECTUM_TYPE_AHEAD "tectum.Ahead.v1"
TECTUM_ASSERT(sizeof(tectum_ahead) == 576);
TECTUM_ASSERT(offsetof(tectum_ahead, header) == 0);
TECTUM_ASSERT(offsetof(tectum_ahead, ticks) == 56);
TECTUM_ASSERT(offsetof(tectum_ahead, commands) == 64);

/* The learner's record of tick k: its step with the reward of tick k-1, and the exploration noise for tick k. */
typedef struct tectum_learning {
    /* Writer, tick and instants. */
    tectum_header header;
    /* The exploration noise in the command of this tick. */
    float noise[16];
    /* The reward that was used; valid only if the flag `LEARNED` is set. */
    float reward;
    /* The factor by which the trace was multiplied before it was added to the weights. */
    float step;
    /* Euclidean norm of the weights after the step. */
    float weights_norm;
    /* Euclidean norm of the eligibility trace after the step. */
    float trace_norm;
    /* Numbers of the agent's own; the log's description of the run has their names (`columns`). Unused entries are
     * 0. */
    float columns[8];
    /* 64-bit hash of the weights after the step; 0 unless the flag `HASHED` is set. */
    uint64_t weights_hash;
} tectum_learning;
#define TECTUM_TYPE_LEARNING "tectum.Learning.v2"
TECTUM_ASSERT(sizeof(tectum_learning) == 176);
TECTUM_ASSERT(offsetof(tectum_learning, header) == 0);
TECTUM_ASSERT(offsetof(tectum_learning, noise) == 56);
TECTUM_ASSERT(offsetof(tectum_learning, reward) == 120);
TECTUM_ASSERT(offsetof(tectum_learning, step) == 124);
TECTUM_ASSERT(offsetof(tectum_learning, weights_norm) == 128);
TECTUM_ASSERT(offsetof(tectum_learning, trace_norm) == 132);
TECTUM_ASSERT(offsetof(tectum_learning, columns) == 136);
TECTUM_ASSERT(offsetof(tectum_learning, weights_hash) == 168);

/* A tracker's measurement: the target and the arm's end-effector. In its header, `tick`, `scheduled_ns`,
 * `incarnation` and `flags` are 0. */
typedef struct tectum_vision {
    /* Writer and instants. `sensed_ns` is the instant at which the picture was taken. `sequence` counts from 0 in
     * each tracker. */
    tectum_header header;
    /* Position of the target, x and y in the arm's coordinates, m. */
    float target[2];
    /* Position of the end-effector, x and y in the arm's coordinates, m. */
    float end[2];
} tectum_vision;
#define TECTUM_TYPE_VISION "tectum.Vision.v1"
TECTUM_ASSERT(sizeof(tectum_vision) == 72);
TECTUM_ASSERT(offsetof(tectum_vision, header) == 0);
TECTUM_ASSERT(offsetof(tectum_vision, target) == 56);
TECTUM_ASSERT(offsetof(tectum_vision, end) == 64);

/* The launcher's board: which phase the run is in. */
typedef struct tectum_control {
    /* A `Phase` as a number. */
    uint32_t phase;
    /* Checkpoints that were requested by a signal so far. */
    uint32_t checkpoints;
    /* Start of tick 0 on the run's clock, ns; valid from `Run` on. */
    uint64_t t0_ns;
    /* Start number of each process within the run, by `Role`. */
    uint32_t incarnations[3];
    /* The processes that have ended without finishing and will not return: bit 0 the plant, 1 the controller, 2 the
     * logger. Nobody waits for them. */
    uint32_t gone;
} tectum_control;
#define TECTUM_TYPE_CONTROL "tectum.Control.v3"
TECTUM_ASSERT(sizeof(tectum_control) == 32);
TECTUM_ASSERT(offsetof(tectum_control, phase) == 0);
TECTUM_ASSERT(offsetof(tectum_control, checkpoints) == 4);
TECTUM_ASSERT(offsetof(tectum_control, t0_ns) == 8);
TECTUM_ASSERT(offsetof(tectum_control, incarnations) == 16);
TECTUM_ASSERT(offsetof(tectum_control, gone) == 28);

/* A process's board: its state and its counts. */
typedef struct tectum_status {
    /* A `ProcessState` as a number. */
    uint32_t state;
    /* Operating-system id of the process. */
    uint32_t pid;
    /* Heartbeat: counts the process's updates of its board. A count that does not change for long is a hang. */
    uint64_t beat;
    /* One more than the tick at whose start a checkpoint is taken; 0 before the first. Plant: the one that it has
     * announced last. Controller: its own last one. */
    uint64_t checkpoint;
    /* Ticks done. */
    uint64_t ticks;
    /* Samples sent on each of its channels. */
    uint64_t sent;
    /* Plant: ticks whose command had not arrived in time. Logger: 0. */
    uint64_t missed;
    /* Plant: commands that arrived after their tick. */
    uint64_t late;
    /* Plant: ticks skipped. Controller: observations that it never received. Logger: samples lost. */
    uint64_t lost;
    /* Logger: ticks consumed. In lockstep the plant waits for this count, so that no sample is lost. */
    uint64_t consumed;
    /* Controller, in real time: total time that its learner has taken after commands were sent, ns. */
    uint64_t learner_ns;
    /* Controller: mean loss over the window in progress. */
    float loss;
    /* Controller: mean error at the end of a target over the window in progress, NaN where there is none. */
    float end_error;
    /* Schema hash of the process's build. */
    uint64_t schema;
    /* Hash of the scenario that the process read. */
    uint64_t scenario;
    /* Hash of the process's build identity. */
    uint64_t build;
} tectum_status;
#define TECTUM_TYPE_STATUS "tectum.Status.v3"
TECTUM_ASSERT(sizeof(tectum_status) == 112);
TECTUM_ASSERT(offsetof(tectum_status, state) == 0);
TECTUM_ASSERT(offsetof(tectum_status, pid) == 4);
TECTUM_ASSERT(offsetof(tectum_status, beat) == 8);
TECTUM_ASSERT(offsetof(tectum_status, checkpoint) == 16);
TECTUM_ASSERT(offsetof(tectum_status, ticks) == 24);
TECTUM_ASSERT(offsetof(tectum_status, sent) == 32);
TECTUM_ASSERT(offsetof(tectum_status, missed) == 40);
TECTUM_ASSERT(offsetof(tectum_status, late) == 48);
TECTUM_ASSERT(offsetof(tectum_status, lost) == 56);
TECTUM_ASSERT(offsetof(tectum_status, consumed) == 64);
TECTUM_ASSERT(offsetof(tectum_status, learner_ns) == 72);
TECTUM_ASSERT(offsetof(tectum_status, loss) == 80);
TECTUM_ASSERT(offsetof(tectum_status, end_error) == 84);
TECTUM_ASSERT(offsetof(tectum_status, schema) == 88);
TECTUM_ASSERT(offsetof(tectum_status, scenario) == 96);
TECTUM_ASSERT(offsetof(tectum_status, build) == 104);

/* The log's own statement that samples of a channel are missing from it. */
typedef struct tectum_gap {
    /* The channel: 0 observation, 1 command, 2 learning. */
    uint64_t channel;
    /* Sequence number of the first missing sample. */
    uint64_t first;
    /* Number of consecutive missing samples. */
    uint64_t count;
    /* Number of missing samples on this channel up to and including these. */
    uint64_t total;
} tectum_gap;
#define TECTUM_TYPE_GAP "tectum.Gap.v1"
TECTUM_ASSERT(sizeof(tectum_gap) == 32);
TECTUM_ASSERT(offsetof(tectum_gap, channel) == 0);
TECTUM_ASSERT(offsetof(tectum_gap, first) == 8);
TECTUM_ASSERT(offsetof(tectum_gap, count) == 16);
TECTUM_ASSERT(offsetof(tectum_gap, total) == 24);

/* Bits of a header's flags. */
enum tectum_flag {
    /* Observation: the first of its writer. Its reward and applied command belong to no tick. */
    TECTUM_FIRST = 1 << 0,
    /* Observation: the command of tick k-1 had not arrived in time, so the hold policy chose the command. */
    TECTUM_MISSED = 1 << 1,
    /* Observation: the hold policy held the last command. */
    TECTUM_HELD = 1 << 2,
    /* Observation: the hold policy let the last command decay. */
    TECTUM_DECAYED = 1 << 3,
    /* Observation: the hold policy stopped the plant (command zero). */
    TECTUM_STOPPED = 1 << 4,
    /* Observation: the gate limited the command. Another flag gives the reason unless it was the command's size
     * alone. */
    TECTUM_CLAMPED = 1 << 5,
    /* Observation: the command contained a value that is not finite. It counts as missed. */
    TECTUM_NON_FINITE = 1 << 6,
    /* Observation: the plant skipped `skipped` ticks because it was late itself. */
    TECTUM_SKIPPED = 1 << 7,
    /* Observation: a new target (or trial) starts with these inputs. The reward belongs to the one before. */
    TECTUM_NEW_TARGET = 1 << 8,
    /* Observation: a command arrived after its tick and was dropped. */
    TECTUM_LATE = 1 << 9,
    /* Command: an input was not a number or out of range, so the command is zero. */
    TECTUM_INVALID = 1 << 10,
    /* Command and learning: learning produced a number that is not finite, and the learner has stopped. When the
     * policy's output is not finite either, the command is zero. */
    TECTUM_DIVERGED = 1 << 11,
    /* Observation: the gate limited the change of the applied command from tick to tick. */
    TECTUM_STEP_LIMITED = 1 << 12,
    /* Observation: the gate kept a joint within its position limits. */
    TECTUM_POSITION_LIMITED = 1 << 13,
    /* Observation: commands had just started to arrive, or to arrive again, and the gate's ramp limited the command. */
    TECTUM_RAMPED = 1 << 14,
    /* Command: the controller received no observation of this tick. The sample states this, and counts as missed. */
    TECTUM_UNHEARD = 1 << 15,
    /* Learning: the weights were changed with the reward of tick k-1. */
    TECTUM_LEARNED = 1 << 16,
    /* Learning: the trace was cleared, because the command applied in tick k-1 was not the policy's. */
    TECTUM_TRACE_CUT = 1 << 17,
    /* Learning: `weights_hash` is valid. */
    TECTUM_HASHED = 1 << 18,
    /* Observation: the plant is hardware with torque off, because it has not been armed. Nothing was applied. */
    TECTUM_UNARMED = 1 << 19,
    /* Observation: the plant is hardware, and its own safety has turned torque off. Nothing was applied. */
    TECTUM_TRIPPED = 1 << 20,
    /* Observation: the plant could not be read, or its tracker had no measurement new enough, in tick k-1 or for
     * this observation. Values that could not be updated, and the reward, are the previous ones. */
    TECTUM_BLIND = 1 << 21,
    /* Observation: the episode ended with tick k-1, in a state after which nothing more can be earned: its value is
     * zero. The inputs are the first of the next episode. */
    TECTUM_TERMINATED = 1 << 22,
    /* Observation: the episode was cut off after tick k-1, for a reason that is not in the inputs, such as a limit
     * of time. The value after it is not zero, but unknown. The inputs are the first of the next episode. */
    TECTUM_TRUNCATED = 1 << 23,
    /* Observation: without a command in time, the gate applied the one for this tick that an earlier command had
     * brought ahead. `MISSED` is set as well. */
    TECTUM_AHEAD = 1 << 24,
};

/* Phases of a run, in order; a number beyond them reads as ABORT. */
enum tectum_phase {
    TECTUM_PHASE_SET_UP = 0,
    TECTUM_PHASE_CONNECT = 1,
    TECTUM_PHASE_RUN = 2,
    TECTUM_PHASE_STOP = 3,
    TECTUM_PHASE_ABORT = 4,
};

/* States of a process, in order; a number beyond them reads as FAILED. */
enum tectum_state {
    TECTUM_STATE_ABSENT = 0,
    TECTUM_STATE_READY = 1,
    TECTUM_STATE_CONNECTED = 2,
    TECTUM_STATE_RUNNING = 3,
    TECTUM_STATE_FINISHED = 4,
    TECTUM_STATE_FAILED = 5,
    TECTUM_STATE_CLOSING = 6,
};

/* Places in `incarnations`. */
enum tectum_role {
    TECTUM_ROLE_PLANT = 0,
    TECTUM_ROLE_CONTROLLER = 1,
    TECTUM_ROLE_LOGGER = 2,
};

#endif
