"""Sixty ways of writing an arm as an MJCF, each alone, then mixed at random; and what is refused."""

import numpy as np

RADIAN = 'angle="radian"'
BODY = {
    "upright": "", "quat": 'quat="1 -1 1 0"', "axisangle": 'axisangle="1 0 1 0.5"', "euler": 'euler=".2 .3 .4"',
    "xyaxes": 'xyaxes="0 2 0 -3 0 0"', "zaxis": 'zaxis="0.6 0.4 2"', "right angle": 'euler="0 1.5707963267948966 0"',
}  # fmt: skip
WEIGHT = {
    "diagonal": '<inertial pos=".12 0 .03" mass="1" diaginertia=".01 .02 .025"/>',
    "turned": '<inertial pos=".12 0 .03" quat="1 1 0 0" mass="1" diaginertia=".01 .02 .025"/>',
    "full": '<inertial pos=".12 0 .03" mass="1" fullinertia=".01 .012 .015 .001 .002 .001"/>',
    "capsule": '<geom type="capsule" fromto="0 0 0 .3 0 0" size=".03"/>',
    "box of a density": '<geom type="box" pos=".1 0 .02" size=".1 .02 .03" density="700"/>',
    "sphere of a mass": '<geom type="sphere" pos=".1 0 .02" size=".05" mass="1.7"/>',
    "two shapes": '<geom type="ellipsoid" pos=".1 0 0" size=".1 .05 .02"/><geom size=".02" pos="0 .1 0" mass=".3"/>',
}
JOINT = {
    "plain": "", "damping": 'damping="2"', "armature": 'armature="0.3"', "spring": 'stiffness="3" springref="0.4"',
    "springdamper": 'springdamper=".1 1"', "place": 'pos="0.05 0 0.02"', "reference": 'ref="0.4"',
    "reference and place": 'ref="-0.3" pos="0 .03 0" springref=".1" stiffness="2"', "slide": 'type="slide"',
    "slide with reference": 'type="slide" ref=".1" stiffness="20"', "endless": 'limited="false"',
    "oblique": 'axis="0.5 1 0.2"',
}  # fmt: skip
WORLD = {
    "": "", "moon": '<option gravity="0 0 -1.62"/>', "wall": '<option gravity="0 -9.81 0"/>',
    "no gravity": '<option><flag gravity="disable"/></option>',
    "no passive forces": '<option><flag spring="disable" damper="disable"/></option>',
}  # fmt: skip
COMPILER = {
    "bound mass": 'boundmass="1.5"', "bound inertia": 'boundinertia=".05"', "total mass": 'settotalmass="9"',
    "order of angles": 'eulerseq="zyx"', "local": 'inertiafromgeom="auto"',
}  # fmt: skip
MORE = {
    "frame": {"inside": '<frame pos="0 0 .1" euler="0 .5 0"><geom size=".03" mass=".4" pos=".1 0 0"/></frame>'},
    "fixed body": {"inside": '<body pos=".2 0 0" euler="1 0 0"><geom size=".05" pos="0 .1 0"/></body>'},
    "third joint held": {"inside": '<body pos=".2 0 0"><joint name="x"/><geom size=".05" pos="0 .1 0"/></body>'},
    "two joints in a body": {"inside": '<joint name="x" axis="0 0 1" pos="0 .01 0"/>'},
    "default class": {"before": '<default><default class="c"><joint damping="1" axis="1 0 0"/></default></default>',
                      "joint": 'class="c"'},
    "gravity taken off": {"first": 'gravcomp=".3"', "body": 'gravcomp=".3"'},
    "gravity taken off by drives": {
        "body": 'gravcomp="1"', "first": 'gravcomp=".5"', "both": 'actuatorgravcomp="true"'},
    "motor with a rotor": {"after": '<actuator><motor joint="e" gear="5" armature=".01" damping=".02"/></actuator>'},
    "tendon of one joint": {"after": '<tendon><fixed stiffness="20" springlength=".1" damping="1"><joint joint="e" '
                            'coef="-2"/></fixed></tendon>'},
    "zero length spring": {
        "inside": '<site name="b" pos=".1 .02 .1"/>',
        "after": '<tendon><spatial stiffness="50" springlength="0"><site site="a"/><site site="b"/></spatial>'
                 '</tendon>'},
    "tendon beside the arm": {
        "inside": '<body pos=".2 0 0"><joint name="x"/><geom size=".05"/></body>',
        "after": '<tendon><fixed stiffness="20"><joint joint="x" coef="1"/></fixed></tendon>'},
    "weld of a held joint": {
        "inside": '<body name="h" pos=".2 0 0"><joint name="x"/><geom size=".05"/></body>',
        "after": '<equality><weld body1="h" body2="b2"/></equality>'},
    "free things around": {"beside": '<body pos="1 0 0"><freejoint/><geom size=".1"/></body>'},
}  # fmt: skip
REFUSED = {
    "gravity taken off one body": {"body": 'gravcomp="1"'},
    "stiffness that grows": {"joint": 'stiffness="1 2"'},
    "tendon of two joints": {"after": '<tendon><fixed name="t" stiffness="20"><joint joint="e" coef="1"/>'
                                      '<joint joint="s" coef="1"/></fixed></tendon>'},
    "slack tendon": {"after": '<tendon><fixed name="t" stiffness="2" springlength="0 1"><joint joint="e" coef="1"/>'
                              '</fixed></tendon>'},
    "tendon of a length": {"inside": '<site name="b" pos=".1 0 .1"/>',
                           "after": '<tendon><spatial name="t" stiffness="9" springlength=".1"><site site="a"/>'
                                    '<site site="b"/></spatial></tendon>'},
    "closed loop": {"after": '<equality><connect name="c" body1="b2" anchor="0 0 0"/></equality>'},
    "no axis": {"joint": 'axis="0 0 0"'},
    "no such class": {"joint": 'class="none"'},
    "no weight": {"weight": ""},
    "impossible inertia": {"weight": '<inertial pos="0 0 0" mass="1" diaginertia="1 1 3"/>'},
    "no number": {"joint": 'range="nan 1"'},
    "no number in a weight": {"weight": '<inertial pos="nan 0 0" mass="1" diaginertia="1 1 1"/>'},
    "infinite": {"joint": 'damping="inf"'},
    "Pinocchio's word": {"joint": "", "name": "universe"},
}  # fmt: skip


def document(*, body="", weight=WEIGHT["diagonal"], joint="", world="", compiler="", inside="", first="", both="",
             before="", after="", beside="", name="e"):  # fmt: skip
    """An arm with the joints s and e; what is given goes to the second of its bodies, or where its name says."""
    axis = "" if "axis" in joint or "class" in joint else 'axis="0 1 0"'
    limits = "" if "limited" in joint or "range" in joint else 'range="-2 2"'
    return f"""<mujoco><compiler {RADIAN} {compiler}/>{world}{before}<worldbody>{beside}
      <body name="b1" pos="0 0 .3" {first}><inertial pos=".1 .02 .05" mass="2" diaginertia=".02 .02 .01"/>
        <joint name="s" axis="0 1 0" range="-2 2" {both}/><site name="a" pos=".2 .01 .1"/>
        <body name="b2" pos=".3 0 0" {body}>{weight}<joint name="{name}" {axis} {limits} {joint} {both}/>{inside}</body>
      </body></worldbody>{after}</mujoco>"""


def variants():
    """By name: the keywords of `document`."""
    alone = [("body", BODY), ("weight", WEIGHT), ("joint", JOINT), ("world", WORLD), ("compiler", COMPILER)]
    found = {name: {place: text} for place, ways in alone for name, text in ways.items() if name} | dict(MORE)
    rng = np.random.default_rng(0)
    while len(found) < 60:
        mixed = {place: str(rng.choice(list(ways.values()))) for place, ways in alone}
        found[f"mixed {len(found)}"] = {**list(MORE.values())[rng.integers(3)], **mixed}
    return found
