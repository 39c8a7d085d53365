"""Messages that tests send in place of a robot."""

from pipeline.ros.topics import read_topics, settings_file, time_message

TOPICS = read_topics(settings_file("baxter"))


def joint_states(names, stamp, position, **fields):
    """Joint states with a stamp [s]; other fields are added, or replace these."""
    return {"header": {"stamp": time_message(stamp)}, "name": list(names), "position": list(position), **fields}
