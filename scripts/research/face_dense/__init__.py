"""Training of the dense facial points on rendered faces of ICT-FaceKit; see ``build``."""
