"""A network whose weights are drawn, its normalisations too: what folding must get right without any training."""

import torch

from agent.perception.enhancement.lu2net import LU2Net


def random_network(seed: int) -> LU2Net:
    torch.manual_seed(seed)
    net = LU2Net()
    for block in net.modules():
        if isinstance(block, torch.nn.BatchNorm2d):
            torch.nn.init.normal_(block.running_mean, 0.0, 0.5)
            torch.nn.init.uniform_(block.running_var, 0.3, 3.0)
            torch.nn.init.uniform_(block.weight, -2.0, 2.0)
            torch.nn.init.normal_(block.bias)
        elif isinstance(block, torch.nn.Conv2d):
            block.weight.data *= 2.0
    return net.eval()
