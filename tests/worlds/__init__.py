"""Recordings with physics that the model does not know, by generators that share no physics code with armdyn."""
