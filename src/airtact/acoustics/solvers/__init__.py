"""How sound travels: a scene and monopoles in, a radiated field out."""
