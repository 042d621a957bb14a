"""Mid-air haptics with the hand in the sound: what every transducer of a phased array must emit."""
