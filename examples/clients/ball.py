"""Follow a hand and feel a ball: start `airtact live touch_ball --from websocket` first.

    python examples/clients/ball.py [ADDRESS]

A recorded hand, in place of your tracker, grasps a ball of 24 mm diameter. Prints where the hand
touches the ball, and the pressure there. Requires pip install 'airtact[mesh,tracking]'.
"""

import sys

import airtact as at

ball = at.VirtualObject(at.sphere(0.012, edge=0.004), name="ball")
motion = at.hands.load_recording(at.example("grasping.jsonl"))

with at.live.Client(*sys.argv[1:]) as client:
    client.objects(ball)
    for frame in at.hands.replay(motion.frames):  # in real time
        client.hands(frame)
        state = client.state
        if frame.sequence % 10 == 0 and state is not None:
            touched = [f"{contact.part} {1e3 * contact.depth:.1f} mm" for contact in state.contacts]
            pressures = [f"{focus.pressure:.0f} Pa" for focus in state.foci]
            print(state.state, *touched, *pressures)
    print(*client.rejected, sep="\n")
