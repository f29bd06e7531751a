"""Drawing of worlds: pictures, videos, and a window to watch them in. Its public names are those of `evogymcm.envs`."""
