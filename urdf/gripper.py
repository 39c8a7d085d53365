"""Find a robot's gripper joints by what they move and how far, not by their names."""

import math
from xml.etree import ElementTree as ET

from urdf.validate import MOVING_JOINT_TYPES, link_of

LIGHT = 1 / 15
"""Largest share that fingers have of what the first joint of their chain moves. Over the 69 robots of the package
example-robot-data: jaws and fingers up to 0.058, the calves of quadrupeds, which open as jaws do, from
0.088."""
OF_PALM = 0.5
"""Largest mass of a lone jaw, of that which carries it: jaws there have up to 0.34, wrists and heads at least 1."""
OPENING = {"revolute": math.pi, "prismatic": 0.1}
"""rad or m; a lone jaw opens by less, jaws there by up to 2.2; a wrist that is as light as a jaw rolls further."""


def gripper_joints(root: ET.Element) -> frozenset[str]:
    """Names of joints of grippers and hands in a URDF, with all joints behind them.

    They move little of the arm's mass, and either there are several on one palm, or one copies another, or it is a lone
    jaw: the last joint, which opens less than half a turn and is lighter than what carries it. Empty where all joints
    would be a gripper's, as in the description of a hand alone.
    """
    tree = _Tree(root)
    copies = [joint for joint in tree.joints.values() if joint.find("mimic") is not None]
    coupled = {str(joint.get("name")) for joint in copies}
    coupled |= {str(mimic.get("joint")) for joint in copies for mimic in joint.findall("mimic")}
    found: set[str] = set()
    for name in tree.moving:
        beside = tree.on(link_of(tree.joints[name], "parent"))
        several = len(beside) > 1 and all(map(tree.is_light, beside))
        if tree.is_light(name) and (several or name in coupled or tree.is_jaw(name)):
            found |= {name, *tree.beyond(name)}
    return frozenset(found) if len(found) < len(tree.moving) else frozenset()


class _Tree:
    """Masses along the joints of a URDF: all joints by name, and the names of those that move."""

    def __init__(self, root: ET.Element) -> None:
        self.joints = {str(joint.get("name")): joint for joint in root.findall("joint")}
        self.moving = [name for name, joint in self.joints.items() if joint.get("type") in MOVING_JOINT_TYPES]
        self._carrier = {link_of(joint, "child"): name for name, joint in self.joints.items()}
        self._carried: dict[str, list[str]] = {}
        for name, joint in self.joints.items():
            self._carried.setdefault(link_of(joint, "parent"), []).append(name)
        self._own = {
            str(link.get("name")): sum(float(mass.get("value", "0")) for mass in link.findall("inertial/mass"))
            for link in root.findall("link")
        }

    def is_light(self, name: str) -> bool:
        """Whether a joint moves only a small share of the mass that the first joint of its chain moves."""
        first = before = name
        while before:
            first = before if before in self.moving else first
            before = self._carrier.get(link_of(self.joints[before], "parent"), "")
        return self._moved(name) < LIGHT * self._moved(first)

    def is_jaw(self, name: str) -> bool:
        """Whether a joint opens and closes a single jaw against the link that carries it."""
        joint, limit = self.joints[name], self.joints[name].find("limit")
        if limit is None or joint.get("type") not in OPENING or self.beyond(name):
            return False
        opening = float(limit.get("upper", "0")) - float(limit.get("lower", "0"))
        palm = sum(self._own[link] for link in self._rigid(link_of(joint, "parent")))
        return 0.0 < opening < OPENING[str(joint.get("type"))] and self._moved(name) < OF_PALM * palm

    def beyond(self, name: str) -> list[str]:
        """Moving joints behind a joint."""
        next_ones = self.on(link_of(self.joints[name], "child"), inner=False)
        return next_ones + [further for each in next_ones for further in self.beyond(each)]

    def on(self, link: str, *, inner: bool = True) -> list[str]:
        """Moving joints on a link and on links fixed to it; with `inner`, also those towards the base."""
        links = self._rigid(link) if inner else self._fixed_to(link)
        return [name for each in links for name in self._carried.get(each, ()) if name in self.moving]

    def _rigid(self, link: str) -> list[str]:
        """A link with all links that are fixed to it, on either side."""
        while (carrier := self._carrier.get(link)) is not None and carrier not in self.moving:
            link = link_of(self.joints[carrier], "parent")
        return self._fixed_to(link)

    def _fixed_to(self, link: str) -> list[str]:
        """A link with all links that are fixed to it, away from the base."""
        found = [link]
        for each in found:
            found += [link_of(self.joints[n], "child") for n in self._carried.get(each, ()) if n not in self.moving]
        return found

    def _moved(self, name: str) -> float:
        """Mass [kg] of all links that a joint moves."""
        links = self._fixed_to(link_of(self.joints[name], "child"))
        behind = (n for link in links for n in self._carried.get(link, ()) if n in self.moving)
        return sum(self._own[link] for link in links) + sum(map(self._moved, behind))
