"""The four-joint arm with mass: MuJoCo in the simulator's place, with the same controller and the same `[plant.arm]`.

    target/release/tectum run examples/python/mujoco.toml
    target/release/tectum run examples/python/mujoco.toml --mode realtime

Inputs, outputs, measures and reward are the simulator's (see its arm's documentation), and so are the targets, draw
by draw. What differs is the body: segments have mass and are under gravity, joints have friction and stops, and
each joint is turned by a motor with a velocity controller of finite gain and torque. So a commanded rate is reached
late, only in part, or not at all.
"""

import math

import mujoco
import numpy as np

import tectum

STEP_S = 0.002  # time step of the physics


def options(parser):
    add = parser.add_argument
    add("--gravity", type=float, default=9.81, help="m/s^2, towards -y")
    add("--mass", type=float, default=0.25, help="of each segment, kg")
    add("--torque", type=float, nargs="+", default=[40, 25, 12, 6], help="largest torque of each motor, N m")
    add("--stiffness", type=float, nargs="+", default=[60, 40, 20, 6], help="torque for an error of 1 rad/s, N m s")
    add("--damping", type=float, default=0.05, help="of each joint, N m s")
    add("--armature", type=float, default=0.01, help="inertia of each motor behind its gear, kg m^2")
    add("--fastest", type=float, default=12.0, help="largest commanded rate of a motor, rad/s")
    add("--range", type=float, default=3.5, help="of each joint to both sides of straight, rad; 0: none")
    add("--velocities", action="store_true", help="observe the joints' velocities as further inputs")


def model(run, arguments):
    """The arm with the scenario's lengths in the x-y plane: each body begins at the end of the one before."""
    arm = run.settings["plant"]["arm"]
    lengths, count = arm["lengths"], len(arm["lengths"])
    each = lambda values: [values[min(i, len(values) - 1)] for i in range(count)]
    bodies, motors = "", ""
    x, y = arm["base"]
    position = f"{x} {y} 0"
    for i, (length, torque, gain) in enumerate(zip(lengths, each(arguments.torque), each(arguments.stiffness))):
        limit = f'limited="true" range="{-arguments.range} {arguments.range}"' if arguments.range else 'limited="false"'
        bodies += f'''<body pos="{position}"><joint name="joint_{i + 1}" axis="0 0 1" {limit}/>
            <geom type="capsule" fromto="0 0 0 {length} 0 0" size="0.02" mass="{arguments.mass}"/>'''
        motors += f'<velocity joint="joint_{i + 1}" kv="{gain}" forcelimited="true" forcerange="{-torque} {torque}"/>'
        position = f"{length} 0 0"
    return mujoco.MjModel.from_xml_string(f'''<mujoco>
        <compiler angle="radian"/>
        <option timestep="{STEP_S}" gravity="0 {-arguments.gravity} 0" integrator="implicitfast"/>
        <default>
            <geom contype="0" conaffinity="0"/>
            <joint damping="{arguments.damping}" armature="{arguments.armature}"/>
        </default>
        <worldbody>{bodies}<site name="end" pos="{position}"/>{"</body>" * count}</worldbody>
        <actuator>{motors}</actuator></mujoco>''')


def wrapped(angles):
    """To [-pi, pi)."""
    return (angles + math.pi) % (2 * math.pi) - math.pi


class MujocoArm(tectum.Plant):
    def __init__(self, run):
        self.arm = run.settings["plant"].get("arm")
        if self.arm is None:
            raise tectum.Refused("mujoco_arm.py needs the table [plant.arm]")
        for key in ("block", "shorten", "mirror", "limits"):
            if self.arm.get(key):
                raise tectum.Refused(f"mujoco_arm.py does not know {key} under [plant.arm]; take it out")
        if self.arm.get("open_loop") or "near" in self.arm["reward"] or self.arm["reward"].get("collision"):
            raise tectum.Refused(
                "mujoco_arm.py knows neither open_loop nor near nor collision under [plant.arm]; take it out")
        self.options = run.arguments
        self.model = model(run, self.options)
        self.data = mujoco.MjData(self.model)
        self.end = self.model.site("end").id
        self.count = len(self.arm["lengths"])
        self.period = run.period
        self.steps = max(round(self.period / STEP_S), 1)
        self.model.opt.timestep = self.period / self.steps
        # Directions are sums of the motors' angles along the arm; relative angles are the motors' own.
        self.absolute = self.arm.get("angles", "absolute") == "absolute"
        self.sum = np.tril(np.ones((self.count, self.count))) if self.absolute else np.eye(self.count)
        self.difference = np.linalg.inv(self.sum)
        self.targets, self.target, self.shown = run.stream("targets"), (0.0, 0.0), 0
        mujoco.mj_forward(self.model, self.data)

    def draw(self):
        """A target, uniform in the part of the arena that the arm can reach: not too far from the base nor too near."""
        (low, high), lengths, (x0, y0) = self.arm["arena"], self.arm["lengths"], self.arm["base"]
        far, f32 = sum(lengths), tectum.f32
        near = max(0.0, max(2 * length - far for length in lengths))
        while True:
            x, y = (f32(low + f32(f32(high - low) * self.targets.single())) for _ in range(2))
            if near**2 <= (x - x0) ** 2 + (y - y0) ** 2 <= far**2:
                return x, y

    def sense(self, tick, inputs):
        due = tick // self.arm["target_every"] + 1
        fresh = due > self.shown
        while self.shown < due:
            given = self.arm.get("targets")
            self.target = given[self.shown % len(given)] if given else self.draw()
            self.shown += 1
        inputs[:2] = self.target
        inputs[2 : 2 + self.count] = wrapped(self.sum @ self.data.qpos)
        if self.options.velocities:
            inputs[2 + self.count :] = self.sum @ self.data.qvel
        return fresh

    def advance(self, tick, applied):
        before = self.sum @ self.data.qpos
        asked = self.difference @ (self.arm["gain"] * np.array(applied))
        self.data.ctrl[:] = np.clip(asked, -self.options.fastest, self.options.fastest)
        mujoco.mj_step(self.model, self.data, self.steps)
        after = self.sum @ self.data.qpos
        rates, angles = (after - before) / self.period, wrapped(after)
        mujoco.mj_kinematics(self.model, self.data)
        x, y = self.data.site_xpos[self.end][:2]
        error = math.hypot(x - self.target[0], y - self.target[1])
        reward = self.arm["reward"]
        cost = error**2 + reward["speed"] * float(rates @ rates) + reward["angle"] * float(angles @ angles)
        return -reward["scale"] * cost, [error, x, y]

    def joints(self):
        return list(wrapped(self.sum @ self.data.qpos)), [self.arm["gain"] * self.period] * self.count


if __name__ == "__main__":
    tectum.main(MujocoArm, "A planar arm with mass in MuJoCo, in the simulator's place", options)
