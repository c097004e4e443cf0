"""The STG-DAT model of docs/model.md in PyTorch, written independently of the onboard code.

The golden vectors are made with it in float64 (`make_golden.py`): it is the yardstick that the Rust code is held against, so
nothing of it follows the Rust code, and it prefers the plainest formula to a fast one.
Shapes stand beside each function: K steps, N agents, S latent draws.
"""

import math

import torch, torch.nn as nn, torch.nn.functional as F

TYPES = ["vehicle", "cyclist", "pedestrian"]
D, DE, LAT, HID = 64, 16, 32, 128
LRELU = 0.01


def lrelu(x):
    return F.leaky_relu(x, LRELU)


def mlp(sizes):
    layers = []
    for i in range(len(sizes) - 1):
        layers.append(nn.Linear(sizes[i], sizes[i + 1]))
    return nn.ModuleList(layers)


def run_mlp(m, x):
    for i, l in enumerate(m):
        x = l(x)
        if i + 1 < len(m):
            x = F.relu(x)
    return x


class BasicBlock(nn.Module):
    def __init__(s, cin, cout, stride):
        super().__init__()
        s.conv1 = nn.Conv2d(cin, cout, 3, stride, 1, bias=False)
        s.bn1 = nn.BatchNorm2d(cout)
        s.conv2 = nn.Conv2d(cout, cout, 3, 1, 1, bias=False)
        s.bn2 = nn.BatchNorm2d(cout)
        s.downsample = None
        if stride != 1 or cin != cout:
            s.downsample = nn.Sequential(nn.Conv2d(cin, cout, 1, stride, bias=False), nn.BatchNorm2d(cout))

    def forward(s, x):
        y = s.bn2(s.conv2(F.relu(s.bn1(s.conv1(x)))))
        r = x if s.downsample is None else s.downsample(x)
        return F.relu(y + r)


class ResNet18(nn.Module):
    def __init__(s, cin=3, width=64, out=32, stem="imagenet"):
        super().__init__()
        s.stem = stem
        k = 7 if stem == "imagenet" else 3
        s.conv1 = nn.Conv2d(cin, width, k, 2, k // 2, bias=False)
        s.bn1 = nn.BatchNorm2d(width)
        c = width
        for i, (m, st) in enumerate([(1, 1), (2, 2), (4, 2), (8, 2)], 1):
            setattr(
                s,
                f"layer{i}",
                nn.Sequential(BasicBlock(c, width * m, st), BasicBlock(width * m, width * m, 1)),
            )
            c = width * m
        s.fc = nn.Linear(c, out)

    def forward(s, x):
        x = F.relu(s.bn1(s.conv1(x)))
        if s.stem == "imagenet":
            x = F.max_pool2d(x, 3, 2, 1)
        x = s.layer4(s.layer3(s.layer2(s.layer1(x))))
        return s.fc(x.mean((2, 3)))


class FeatureExtractor(nn.Module):
    def __init__(s, width, context=True, stem="imagenet"):
        super().__init__()
        se = D // 2 if context else D
        s.state = nn.ModuleDict({t: mlp([6, 128, 128, 128, se]) for t in TYPES})
        s.relation = mlp([6, 128, 128, 128, DE])
        s.context = ResNet18(3, width, D // 2, stem) if context else None


class TopoRound(nn.Module):
    def __init__(s, heads, edge_update, edge_in_message=False, distance_scale=False):
        super().__init__()
        s.heads, s.distance_scale = heads, distance_scale
        s.u_e = nn.Linear(DE, D, bias=False) if edge_in_message else None
        s.w_n = nn.Linear(D, D, bias=False)
        s.lambda_raw = nn.Parameter(torch.zeros(heads))
        s.mu_raw = nn.Parameter(torch.zeros(heads))
        s.edge = mlp([2 * D + DE, 128, DE]) if edge_update else None

    def forward(s, v, e, adj):
        # v [K,N,D]  e [K,N,N,DE]  adj [K,N,N] bool, diagonal true where the agent is present
        lam, mu = F.softplus(s.lambda_raw), F.softplus(s.mu_raw)
        dv = (v[:, :, None, :] - v[:, None, :, :]).pow(2).sum(-1)
        de = e.pow(2).sum(-1)
        if s.distance_scale:
            dv, de = dv / D, de / DE
        msg = lrelu(s.w_n(v)).view(v.shape[0], v.shape[1], s.heads, D // s.heads)
        outs, alphas = [], []
        for h in range(s.heads):
            logit = -(lam[h] * dv + mu[h] * de)
            logit = logit.masked_fill(~adj, float("-inf"))
            a = torch.softmax(logit, -1)
            a = torch.where(adj, a, torch.zeros_like(a))
            alphas.append(a)
            if s.u_e is None:
                outs.append(a @ msg[:, :, h, :])
            else:
                w = D // s.heads
                m = (
                    s.w_n(v)[:, None, :, h * w : (h + 1) * w] + s.u_e(e)[..., h * w : (h + 1) * w]
                )  # [K,i,j,w]
                outs.append((a[..., None] * lrelu(m)).sum(2))
        vb = torch.cat(outs, -1)
        if s.edge is not None:
            n = v.shape[1]
            cat = torch.cat(
                [vb[:, :, None, :].expand(-1, -1, n, -1), vb[:, None, :, :].expand(-1, n, -1, -1), e], -1
            )
            e = run_mlp(s.edge, cat)
        return vb, e, torch.stack(alphas, 1)


class Temporal(nn.Module):
    def __init__(s, heads, literal=False):
        super().__init__()
        s.heads = D if literal else heads
        s.score = nn.Linear(D, s.heads, bias=False)
        s.value = s.score if literal else nn.Linear(D, D, bias=False)

    def forward(s, v, present):
        # v [K,N,D], present [K,N] -> [N,D], beta [K,N,heads]
        sc = lrelu(s.score(v)).masked_fill(~present[..., None], float("-inf"))
        b = torch.softmax(sc, 0)
        val = s.value(v).view(v.shape[0], v.shape[1], s.heads, D // s.heads)
        # the paper applies f_act to the weighted term; beta > 0 makes LeakyReLU commute with it
        out = lrelu(b[..., None] * val).sum(0)
        return out.reshape(v.shape[1], D), b


class STGDAT(nn.Module):
    def __init__(
        s,
        width=64,
        rounds=2,
        topo_heads=4,
        temp_heads=4,
        context=True,
        stem="imagenet",
        edge_in_message=False,
        distance_scale=False,
        literal=False,
    ):
        super().__init__()
        s.fe = FeatureExtractor(width, context, stem)
        s.gdat = nn.Module()
        s.gdat.topological = nn.ModuleList(
            [TopoRound(topo_heads, r + 1 < rounds, edge_in_message, distance_scale) for r in range(rounds)]
        )
        s.gdat.temporal = Temporal(temp_heads, literal)
        s.encoder = mlp([2 * D, 128, 128, LAT])
        s.decoder = nn.ModuleDict(
            {
                t: nn.ModuleDict({"gru": nn.GRUCell(6 + D + LAT, HID), "head": nn.Linear(HID, 5)})
                for t in TYPES
            }
        )

    def embed(s, types, state, phi, patches):
        # state [K,N,6] phi [K,N,N,6] patches [K,N,3,H,W]
        K, N = state.shape[:2]
        se = torch.stack([run_mlp(s.fe.state[TYPES[types[i]]], state[:, i]) for i in range(N)], 1)
        re = run_mlp(s.fe.relation, phi)
        if s.fe.context is not None:
            ce = s.fe.context(patches.flatten(0, 1)).view(K, N, -1)
            return torch.cat([se, ce], -1), re
        return se, re

    def gdat_forward(s, v, e, adj, present):
        alphas = []
        for r in s.gdat.topological:
            v, e, a = r(v, e, adj)
            alphas.append(a)
        out, beta = s.gdat.temporal(v, present)
        return out, alphas, beta

    def latent_mean(s, vh, vf):
        return run_mlp(s.encoder, torch.cat([vh, vf], -1))

    def decode(s, types, state, present, vh, z, horizon):
        # state [T_h,N,6], vh [N,D], z [S,N,LAT] -> [S,N,horizon,5]
        S, N = z.shape[:2]
        out = torch.zeros(S, N, horizon, 5, dtype=vh.dtype)
        for i in range(N):
            dec = s.decoder[TYPES[types[i]]]
            h = torch.zeros(1, HID, dtype=vh.dtype)
            for k in range(state.shape[0]):
                if not bool(present[k, i]):
                    continue
                x = torch.cat([state[k, i], torch.zeros(D + LAT, dtype=vh.dtype)])[None]
                h = dec["gru"](x, h)
            h = h.expand(S, HID)
            for k in range(horizon):
                if k == 0:
                    x = torch.cat([torch.zeros(S, 6, dtype=vh.dtype), vh[i].expand(S, D), z[:, i]], -1)
                else:
                    x = torch.zeros(S, 6 + D + LAT, dtype=vh.dtype)
                h = dec["gru"](x, h)
                out[:, i, k] = dec["head"](h)
        return out


def agent_frame(pos, vel, psi, present):
    """state features s_i^k in the frame of agent i's last observed step: pos [K,N,2] vel [K,N,2] psi [K,N]"""
    K = pos.shape[0]
    o, th = pos[-1], psi[-1]
    c, s_ = torch.cos(th), torch.sin(th)
    R = torch.stack([torch.stack([c, s_], -1), torch.stack([-s_, c], -1)], -2)  # world -> agent
    p = torch.einsum("nij,knj->kni", R, pos - o)
    v = torch.einsum("nij,knj->kni", R, vel)
    d = psi - th
    f = torch.cat([p, v, torch.cos(d)[..., None], torch.sin(d)[..., None]], -1)
    return torch.where(present[..., None], f, torch.zeros_like(f))


def relation(pos, vel, psi, present):
    c, s_ = torch.cos(psi), torch.sin(psi)
    R = torch.stack([torch.stack([c, s_], -1), torch.stack([-s_, c], -1)], -2)  # [K,N,2,2]
    dp = pos[:, None, :, :] - pos[:, :, None, :]  # [K,i,j]: p_j - p_i
    dv = vel[:, None, :, :] - vel[:, :, None, :]
    dp = torch.einsum("kiab,kijb->kija", R, dp)
    dv = torch.einsum("kiab,kijb->kija", R, dv)
    dpsi = psi[:, None, :] - psi[:, :, None]
    f = torch.cat([dp, dv, torch.cos(dpsi)[..., None], torch.sin(dpsi)[..., None]], -1)
    ok = present[:, :, None] & present[:, None, :]
    return torch.where(ok[..., None], f, torch.zeros_like(f))


def adjacency(pos, present, d):
    dist = (pos[:, None] - pos[:, :, None]).norm(dim=-1)
    return (dist <= d) & present[:, :, None] & present[:, None, :]


# ---- kinematics -------------------------------------------------------------------------------------------
def bicycle_step(s, u, lr, dt):
    x, y, psi, v, b = s.unbind(-1)
    a, bd = u.unbind(-1)
    return torch.stack(
        [
            x + v * torch.cos(psi + b) * dt,
            y + v * torch.sin(psi + b) * dt,
            psi + v / lr * torch.sin(b) * dt,
            v + a * dt,
            b + bd * dt,
        ],
        -1,
    )


def bicycle_jacobians(s, lr, dt):
    x, y, psi, v, b = s.unbind(-1)
    g = psi + b
    one, zero = torch.ones_like(x), torch.zeros_like(x)
    Fs = torch.stack(
        [
            torch.stack([one, zero, -v * torch.sin(g) * dt, torch.cos(g) * dt, -v * torch.sin(g) * dt], -1),
            torch.stack([zero, one, v * torch.cos(g) * dt, torch.sin(g) * dt, v * torch.cos(g) * dt], -1),
            torch.stack([zero, zero, one, torch.sin(b) / lr * dt, v * torch.cos(b) / lr * dt], -1),
            torch.stack([zero, zero, zero, one, zero], -1),
            torch.stack([zero, zero, zero, zero, one], -1),
        ],
        -2,
    )
    Fu = torch.zeros(*x.shape, 5, 2, dtype=s.dtype)
    Fu[..., 3, 0] = dt
    Fu[..., 4, 1] = dt
    return Fs, Fu


def bicycle_midpoint_step(s, u, lr, dt):
    x, y, psi, v, b = s.unbind(-1)
    a, bd = u.unbind(-1)
    v1, b1 = v + a * dt, b + bd * dt
    vm, bm = (v + v1) / 2, (b + b1) / 2
    w = vm * torch.sin(bm) / lr
    course = psi + w * dt / 2 + bm
    return torch.stack(
        [x + vm * torch.cos(course) * dt, y + vm * torch.sin(course) * dt, psi + w * dt, v1, b1], -1
    )


def midpoint_jacobians(s, u, lr, dt):
    """by automatic differentiation, one state and control at a time"""
    fs = torch.func.vmap(torch.func.jacrev(lambda a, b: bicycle_midpoint_step(a, b, lr, dt), argnums=0))
    fu = torch.func.vmap(torch.func.jacrev(lambda a, b: bicycle_midpoint_step(a, b, lr, dt), argnums=1))
    sh = s.shape[:-1]
    return fs(s.reshape(-1, 5), u.reshape(-1, 2)).view(*sh, 5, 5), fu(
        s.reshape(-1, 5), u.reshape(-1, 2)
    ).view(*sh, 5, 2)


def control(raw):
    """raw [...,5] -> mean [...,2], Cholesky factor L [...,2,2]"""
    m = raw[..., :2]
    l00 = torch.exp(raw[..., 2].clamp(-5, 2))
    l11 = torch.exp(raw[..., 3].clamp(-5, 2))
    l10 = raw[..., 4]
    L = torch.zeros(*raw.shape[:-1], 2, 2, dtype=raw.dtype)
    L[..., 0, 0], L[..., 1, 0], L[..., 1, 1] = l00, l10, l11
    return m, L


def saturate(u, lim):
    return lim * torch.tanh(u / lim)


# ---- context maps -----------------------------------------------------------------------------------------
def build_map(points, vels, origin, shape):
    """points [M,2], vels [M,2]; cell (row i along y, column j along x) of 1 m; -> density [h,w], velocity [2,h,w]"""
    h, w = shape
    j = torch.floor(points[:, 0] - origin[0]).long()
    i = torch.floor(points[:, 1] - origin[1]).long()
    ok = (i >= 0) & (i < h) & (j >= 0) & (j < w)
    idx = i[ok] * w + j[ok]
    cnt = torch.zeros(h * w, dtype=points.dtype).index_add_(
        0, idx, torch.ones(int(ok.sum()), dtype=points.dtype)
    )
    vx = torch.zeros(h * w, dtype=points.dtype).index_add_(0, idx, vels[ok, 0])
    vy = torch.zeros(h * w, dtype=points.dtype).index_add_(0, idx, vels[ok, 1])
    n = cnt.clamp(min=1)
    return (cnt / cnt.sum()).view(h, w), torch.stack([vx / n, vy / n]).view(2, h, w)


def patch(density, velocity, origin, p, psi, cell, size):
    """local patch [3,size,size]; bilinear between cell centres, zero outside (each missing corner counts as zero)"""
    h, w = density.shape
    r = torch.arange(size, dtype=density.dtype)
    xl = ((size - 1) / 2 - r)[:, None] * cell
    yl = ((size - 1) / 2 - r)[None, :] * cell
    c, s = math.cos(psi), math.sin(psi)
    X = p[0] + c * xl - s * yl
    Y = p[1] + s * xl + c * yl
    fx = X - origin[0] - 0.5
    fy = Y - origin[1] - 0.5
    x0, y0 = torch.floor(fx), torch.floor(fy)
    wx, wy = fx - x0, fy - y0
    mean_nz = density[density > 0].mean() if (density > 0).any() else torch.tensor(1.0, dtype=density.dtype)
    chans = [torch.log1p(density / mean_nz), velocity[0], velocity[1]]

    def corner(m, yy, xx):
        ok = (yy >= 0) & (yy < h) & (xx >= 0) & (xx < w)
        return torch.where(ok, m[yy.clamp(0, h - 1).long(), xx.clamp(0, w - 1).long()], torch.zeros_like(xx))

    out = []
    for m in chans:
        out.append(
            (1 - wy) * ((1 - wx) * corner(m, y0, x0) + wx * corner(m, y0, x0 + 1))
            + wy * ((1 - wx) * corner(m, y0 + 1, x0) + wx * corner(m, y0 + 1, x0 + 1))
        )
    d, vx, vy = out
    return torch.stack([d, c * vx + s * vy, -s * vx + c * vy])


# ---- losses -----------------------------------------------------------------------------------------------
def imq_mmd(a, b):
    n, m = a.shape[0], b.shape[0]

    def k(x, y):
        d2 = (x[:, None] - y[None]).pow(2).sum(-1)
        return sum(c / (c + d2) for c in [2 * LAT * s for s in (0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0)])

    kaa, kbb, kab = k(a, a), k(b, b), k(a, b)
    return (
        (kaa.sum() - kaa.diagonal().sum()) / (n * (n - 1))
        + (kbb.sum() - kbb.diagonal().sum()) / (m * (m - 1))
        - 2 * kab.mean()
    )


def kl(m, sigma):
    return 0.5 * (m.pow(2).sum(-1) + LAT * (sigma**2 - 1 - 2 * math.log(sigma)))
