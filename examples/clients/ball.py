"""Follow a hand and feel a ball: start `airtact live live_pinch --from websocket` first.

    python examples/clients/ball.py [ADDRESS]

A recorded hand, which stands for your tracker, closes on a ball of 40 mm. Prints where the hand
touches it and the pressure that each focus gets. Needs pip install 'airtact[mesh,tracking]'.
"""

import sys

import airtact as at

ball = at.VirtualObject(at.sphere(0.02, edge=0.005), name="ball")
motion = at.hands.load_recording(at.example("reaching.jsonl"))

with at.live.Client(*sys.argv[1:]) as client:
    client.objects(ball)
    for frame in at.hands.replay(motion.frames):  # in real time
        client.hands(frame)
        # The ball is held by thumb and index finger.
        client.move("ball", at.Pose.shift(frame.landmarks[[4, 9]].mean(axis=0)))
        state = client.state
        if frame.sequence % 60 == 0 and state is not None:
            touched = [f"{contact.part} {1e3 * contact.depth:.1f} mm" for contact in state.contacts]
            pressures = [f"{focus.pressure:.0f} Pa" for focus in state.foci]
            print(state.state, *touched, *pressures)
    print(*client.rejected, sep="\n")
