from lieednn_sim.render.gl import *
