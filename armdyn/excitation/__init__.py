"""Motions of an arm that tell as much as possible about chosen effects."""
