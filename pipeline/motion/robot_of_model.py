"""The description of a robot with the links, load, damping, rotors, springs and mounting that its model found."""

import hashlib
from dataclasses import replace

import numpy as np
import pinocchio as pin

from armdyn.arm.model import ArmModel
from pipeline.exports.parts import exported_joint_dynamics
from urdf import Robot
from urdf.robot import Spring

MODEL_SPRING_SOURCE = "the model"
"""Source of springs that a model has."""


def robot_of_model(model: ArmModel) -> Robot:
    """The robot of an arm's model as it is, for what needs a description: tables, postures, dynamics.

    Dry friction is that of a joint that creeps. What depends on the load, and what else no description has, is left
    out. Springs are those of the model alone.
    """
    theta, parts = model.theta(), exported_joint_dynamics(model)
    rigid = model.rigid_body_model_at(theta)
    rigid.gravity = pin.Motion(np.concatenate([model.gravity(), np.zeros(3)]))
    rigid.damping = np.array([joint.damping for joint in parts])
    dry = np.array([joint.friction + joint.stribeck[0] for joint in parts])
    uneven = np.array([joint.uneven for joint in parts])
    rigid.upperDryFrictionLimit, rigid.lowerDryFrictionLimit = uneven + dry, uneven - dry
    springs = tuple(
        Spring(joint.name, *joint.spring, True, MODEL_SPRING_SOURCE, joint.stiffness, joint.rest)
        for joint in parts
        if any(joint.spring) or joint.stiffness
    )
    values = hashlib.sha256(f"{model.robot.fingerprint}\n{model.names}".encode() + theta.tobytes())
    return replace(model.robot, model=rigid, springs=springs, fingerprint=values.hexdigest())
