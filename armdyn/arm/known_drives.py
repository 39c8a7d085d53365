"""Known kinds of servo drives, with their usual settings; a model file's table ``[drives.NAME]`` begins with them.

Largest torques are the makers' stall torques, at the voltage `supply`. A position gain is stated only where somebody
has measured it; where it is left out, armdyn estimates it from the recordings. Other settings than those stated are
recorded as ``extra.gain_scale``.

Sources: Robotis, https://emanual.robotis.com/docs/en/dxl/x/MODEL/ and .../dxl/mx/MODEL/, "Stall Torque"; Rhoban's BAM,
https://github.com/Rhoban/bam, ``bam/params/MODEL/m1.json`` for the torque constant k_t and the resistance R, and
``bam/dynamixel/actuator.py`` for the share e of the full duty per rad of error and unit of the register P, which was
measured there. At the voltage V the gain is e P V k_t/R. BAM's models with a friction that grows with the load (m6)
have up to 1.7 times that k_t/R: hence a spread of 30 %.
"""

from collections.abc import Mapping

KNOWN_DRIVES: Mapping[str, Mapping[str, str]] = {
    # Feetech. At 7.4 V and register P = 32: k_p 17.8 N m/rad, 3.35 N m (Open Duck Mini's MJCF; P and V as in Rhoban's
    # BAM, whose values it has). LeRobot sets P = 16. At 12 V both are larger: the recording says by how much.
    "sts3215": {"law": "position", "gain": "8.9 N m/rad +/- 10 %", "limit": "3.35 N m"},
    # The 12 V version of the STS3215, 30 kg cm: https://robonine.com/testing-of-feetech-sts3215-servomotor-backlash-
    # repeatability-and-torque, which measured 35 kg cm.
    "sts3215-c018": {"law": "position", "limit": "2.94 N m", "supply": "12 V"},
    # 50 kg cm: https://robonine.com/feetech-sts3250-smart-actuator-evaluation-of-accuracy-torque-and-backlash
    "sts3250": {"law": "position", "limit": "4.9 N m", "supply": "12 V"},
    # Full duty from an error of 885 x 256 x 2 pi/4096 / P rad at register P; here P = 100: BAM (Rhoban).
    "xl330": {"law": "position", "full_at": "3.47 rad"},
    "xl330-m077": {"law": "position", "limit": "0.215 N m", "supply": "5 V"},
    # BAM: k_t/R = 0.387 N m/A / 4.02 ohm, e = 4096 / (2 pi 256 885); P = 400, as it is delivered.
    "xl330-m288": {"law": "position", "gain": "0.55 N m/rad +/- 30 %", "limit": "0.52 N m", "supply": "5 V"},
    "xc330-m181": {"law": "position", "limit": "0.6 N m", "supply": "5 V"},
    "xc330-m288": {"law": "position", "limit": "0.93 N m", "supply": "5 V"},
    "xc330-t181": {"law": "position", "limit": "0.8 N m", "supply": "12 V"},
    "xc330-t288": {"law": "position", "limit": "1 N m", "supply": "12 V"},
    "xl430-w250": {"law": "position", "limit": "1.5 N m", "supply": "12 V"},
    "2xl430-w250": {"law": "position", "limit": "1.5 N m", "supply": "12 V"},
    "xc430-w150": {"law": "position", "limit": "1.6 N m", "supply": "12 V"},
    "xc430-w240": {"law": "position", "limit": "1.9 N m", "supply": "12 V"},
    "xm430-w350": {"law": "position", "limit": "4.1 N m", "supply": "12 V"},
    "xm540-w150": {"law": "position", "limit": "7.3 N m", "supply": "12 V"},
    "xm540-w270": {"law": "position", "limit": "10.6 N m", "supply": "12 V"},
    "xl320": {"law": "position", "limit": "0.39 N m", "supply": "7.4 V"},
    "ax12a": {"law": "position", "limit": "1.5 N m", "supply": "12 V"},
    "mx28": {"law": "position", "limit": "2.5 N m", "supply": "12 V"},
    # BAM: k_t/R = 1.62 N m/A / 3.95 ohm, e = 0.158; P = 32 of protocol 1.0.
    "mx64": {"law": "position", "gain": "25 N m/rad +/- 30 %", "limit": "6 N m", "supply": "12 V"},
    # BAM: k_t/R = 2.19 N m/A / 2.96 ohm, e = 0.158; P = 32 of protocol 1.0.
    "mx106": {"law": "position", "gain": "45 N m/rad +/- 30 %", "limit": "8.4 N m", "supply": "12 V"},
}
"""Settings of kinds of drives: attributes of `armdyn.arm.drives.Servo`, as texts with units."""
