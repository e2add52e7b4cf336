"""Random tree walks on depth (Jung, Lee, Heo and Yun, CVPR 2015): a regression tree a joint, walks along the skeleton."""
