"""A speed loop on the motor: the head is to turn at a set speed whatever the medium does.

Two ways to the same end: a controller outside that steps the simulation (as a real-time controller
would), and an actuator law inside the robot. ``python examples/speed_loop.py --help`` lists its options.
"""

from __future__ import annotations

import argparse

import numpy as np

import rodnet as rn

SET_POINT = 60.0  # speed of the head [rpm]
GAIN, INTEGRAL = 0.5, 8.0  # [1], [1/s]


def outside(duration: float = 4.0, dt: float = 1e-2) -> np.ndarray:
    """Step by step: read a sensor, send a command. Returns (time, head speed, command), shape (n, 3)."""
    sim = rn.Simulation(rn.robots.flagellated(n_tails=2, rpm=20.0), dt=dt)
    command, integral, log = 20.0, 20.0, []
    for _ in range(round(duration / dt)):
        result = sim.step({"motor.rpm": command})
        if not result.ok:
            raise SystemExit(f"the step failed: {result.status.value}")
        error = SET_POINT - result.state.sensors["head_rpm"]
        integral += INTEGRAL * error * dt
        command = integral + GAIN * error
        log.append((result.state.t, result.state.sensors["head_rpm"], command))
    return np.array(log)


class SpeedLoop(rn.Actuator):
    """Proportional control of the head's speed as a law: its rate follows from what the sensor says."""

    default_name = "loop"
    drives = "twist_rate"
    set_point = rn.Parameter(SET_POINT, unit="rpm")
    feed_forward = rn.Parameter(62.0, unit="rpm")
    gain = rn.Parameter(GAIN, unit="1", bounds=(0, None))

    def command(self, t, sensors, p):
        """Rate of the motor [rad/s]."""
        rpm = p.feed_forward + p.gain * (p.set_point - sensors["head_rpm"])
        return rpm * 2.0 * np.pi / 60.0


def inside(duration: float = 4.0, dt: float = 1e-2) -> rn.Trajectory:
    """Run with the law in the robot; stop early if the head turns too fast."""
    robot = rn.robots.flagellated(n_tails=2, rpm=20.0)
    terms = [t for t in robot.terms if t.name != "motor"]
    robot = rn.Robot(robot.graph, [*terms, SpeedLoop(at="head:1")], sensors=robot.sensors)
    reached = rn.Event(lambda s: s.sensors["head_rpm"] - 0.99 * SET_POINT, name="reached", direction=1)
    sim = rn.Simulation(robot, dt=dt)
    return sim.run(duration, events=[reached], stop=lambda s: s.sensors["head_rpm"] > 2.0 * SET_POINT)


def main(arguments: list[str] | None = None) -> dict[str, float]:
    """Run both; return the speeds reached [rpm]."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--duration", type=float, default=4.0, help="seconds to simulate (default: 4)")
    parser.add_argument("--dt", type=float, default=1e-2, help="time step in seconds (default: 0.01)")
    options = parser.parse_args(arguments)
    if not 0.0 < options.dt < options.duration:
        parser.error("--duration and --dt must be positive, and the time step the shorter of the two")
    log, traj = outside(options.duration, options.dt), inside(options.duration, options.dt)
    head = traj.robot.graph.rods["head"].edges[0]
    speeds = {
        "outside_rpm": float(log[-1, 1]),
        "command_rpm": float(log[-1, 2]),
        "inside_rpm": float(abs(traj.w[-1, head]) * 60.0 / (2.0 * np.pi)),
    }
    reached = f"{traj.events['reached'][0]:.3f} s" if traj.events["reached"] else "no time yet, run longer"
    print(f"stepwise control: head {speeds['outside_rpm']:.3f} rpm, motor {speeds['command_rpm']:.2f} rpm")
    print(f"actuator law:     head {speeds['inside_rpm']:.3f} rpm; 99 % reached at {reached}")
    return speeds


if __name__ == "__main__":
    main()
