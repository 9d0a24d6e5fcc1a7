"""Dense facial points: lips, jaw, lids, irises and brows, and the actions that follow from them.

Networks and expressions were derived from rendered faces of ICT-FaceKit (USC Institute for Creative
Technologies, MIT licence); ``scripts/build face-dense`` derives them again.
"""
