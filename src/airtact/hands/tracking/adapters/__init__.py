"""Programs that stand between a tracker and ``WebSocketReceiver``, each in a process of its own.

``mediapipe_camera`` and ``realsense`` import nothing of airtact, so that they run in an environment
of their own: their libraries need versions of NumPy that airtact does not take.
"""
