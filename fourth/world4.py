"""Fourth world: machines on cranks and cables, own kinematics and physics (NumPy/SciPy).

Limb i of every machine: |P_i(x) - E_i(q_i)| = L_i(q_i). A fault is a perturbation of the
drive angles dq (n, 3), lengths dl (n, 3), base points dE (n, 3, 3), of the tool in the
platform's frame dt (n, 3), and of the reading in the instrument's frame dr (n, 3).
"""
from __future__ import annotations
import csv, dataclasses, json, shutil, sys
from pathlib import Path
import numpy as np
HERE = Path(__file__).resolve().parent
G = 9.81
E3 = np.eye(3)

# ---------------------------------------------------------------- machines
class Mach:
    planar = False
    def P(self, x, th): raise NotImplementedError      # (n,3,3) limb, xyz
    def E(self, q, th): raise NotImplementedError
    def L(self, q, th): raise NotImplementedError      # (n,3)
    def fk(self, q, th, x0, f=None):
        """Pose (n,3) by Newton from x0."""
        x = x0.copy()
        for _ in range(30):
            r = self.res(x, q, th, f)
            J = np.stack([(self.res(x + h, q, th, f) - r) / 1e-7 for h in 1e-7 * E3], -1)
            s = np.linalg.solve(J, -r[..., None])[..., 0]
            x = x + s
            if np.abs(s).max() < 1e-12: break
        assert np.abs(self.res(x, q, th, f)).max() < 1e-10
        return x
    def res(self, x, q, th, f):
        dq = 0. if f is None else f.dq; dl = 0. if f is None else f.dl; dE = 0. if f is None else f.dE
        d = self.P(x, th) - self.E(q + dq, th) - dE
        return np.linalg.norm(d, axis=-1) - self.L(q + dq, th) - dl
    def ik(self, x, th):
        """Drive angles (n,3) by Newton, limb by limb."""
        q = np.tile(self.q0, (len(x), 1)).astype(float)
        for _ in range(60):
            r = self.res(x, q, th, None)
            s = -r / ((self.res(x, q + 1e-7, th, None) - r) / 1e-7)
            q = q + np.clip(s, -self.qstep, self.qstep)
            if np.abs(s).max() < 1e-12: break
        assert np.abs(self.res(x, q, th, None)).max() < 1e-10
        return q
    def tool(self, x, tool, dt):
        return x + tool + dt

class Delta(Mach):
    name = "rotary3"; chan = ("x", "y", "z"); sigma = 8e-6; drive = 'drive = { kind = "gear", ratio = 50 }'
    ang = np.radians([90., 210., 330.]); Rb, Up, Lo = .160, .240, .560
    out = np.stack([np.cos(ang), np.sin(ang), 0 * ang], -1)
    q0 = np.array([.6] * 3); qstep = .3
    home = np.array([0, 0, -.50]); half = np.array([.15, .15, .07])
    weight = 60.; pay = (0., 40.); arm = .24
    tools = np.array([[.06, .0, -.03], [-.03, .05, -.03]])
    names = [f"{s}{i}" for i in (1, 2, 3) for s in ("rad", "up", "lo", "zero", "hgt")]
    nom = np.array([.160, .240, .560, 0, 0] * 3); sd = np.array([2e-4, 1e-4, 1.5e-4, 1e-3, 2e-4] * 3)
    def P(self, x, th): return np.repeat(x[:, None], 3, 1)
    def E(self, q, th):
        t = th.reshape(3, 5); a = q + t[:, 3]
        e = (t[:, 0] + t[:, 1] * np.cos(a))[..., None] * self.out
        e[..., 2] = t[:, 4] - t[:, 1] * np.sin(a); return e
    def L(self, q, th): return np.broadcast_to(th.reshape(3, 5)[:, 2], q.shape)

class Planar(Mach):
    name = "slide3"; chan = ("x", "y"); sigma = 8e-6; planar = True
    drive = 'drive = { kind = "gear", stages = [7, 9] }'
    ang = np.radians([210., 330., 90.]); B, A, C, R = .420, .110, .230, .270
    inw = ang - np.pi; q0 = inw + 1.; qstep = .3
    home = np.zeros(3); half = np.array([.07, .07, .25])
    weight = 0.; pay = (0., 0.); arm = .23
    tools = np.array([[.09, .02, 0.], [-.05, .08, 0.]])
    names = [f"{s}{i}" for i in (1, 2, 3) for s in ("crank", "rod", "zero", "mx", "my", "px", "py")]
    nom = np.array([.230, .270, 0, 0, 0, 0, 0] * 3); sd = np.array([1e-4, 1e-4, 2e-3, 2e-4, 2e-4, 1e-4, 1e-4] * 3)
    def _rot(self, x, v):
        c, s = np.cos(x[:, 2]), np.sin(x[:, 2])
        return np.stack([c[:, None] * v[..., 0] - s[:, None] * v[..., 1], s[:, None] * v[..., 0] + c[:, None] * v[..., 1], 0 * v[..., 0]], -1)
    def P(self, x, th):
        t = th.reshape(3, 7); a = np.stack([self.A * np.cos(self.ang) + t[:, 5], self.A * np.sin(self.ang) + t[:, 6], 0 * self.ang], -1)
        p = self._rot(x, np.repeat(a[None], len(x), 0)); p[..., :2] += x[:, None, :2]; return p
    def E(self, q, th):
        t = th.reshape(3, 7); a = q + t[:, 2]
        return np.stack([self.B * np.cos(self.ang) + t[:, 3] + t[:, 0] * np.cos(a), self.B * np.sin(self.ang) + t[:, 4] + t[:, 0] * np.sin(a), 0 * a], -1)
    def L(self, q, th): return np.broadcast_to(th.reshape(3, 7)[:, 1], q.shape)
    def tool(self, x, tool, dt):
        v = np.broadcast_to(tool, (len(x), 3)) + dt
        p = self._rot(x, v[:, None])[:, 0]; p[:, :2] += x[:, :2]; return p

class Hang(Mach):
    name = "hang3"; chan = ("x", "y", "z"); sigma = 40e-6; drive = 'drive = "cable"'
    ang = np.radians([80., 200., 320.]); Ra, Ha, Rd = 1.6, 2.4, .05
    anchor = np.stack([Ra * np.cos(ang), Ra * np.sin(ang), Ha + 0 * ang], -1)
    home = np.array([0, 0, .9]); half = np.array([.45, .45, .25])
    l0 = np.linalg.norm(anchor - home, axis=1)
    q0 = np.zeros(3); qstep = 5.
    weight = 80.; pay = (0., 60.); arm = 1.
    tools = np.array([[0., .0, -.05], [.08, .03, -.05]])
    names = [f"{s}{i}" for i in (1, 2, 3) for s in ("ax", "ay", "az", "len", "drum")]
    nom = np.array([0, 0, 0, 0, .05] * 3); sd = np.array([1e-3, 1e-3, 1e-3, 1e-3, 2e-5] * 3)
    def P(self, x, th): return np.repeat(x[:, None], 3, 1)
    def E(self, q, th): return np.broadcast_to(self.anchor + th.reshape(3, 5)[:, :3], (*q.shape, 3))
    def L(self, q, th):
        t = th.reshape(3, 5); return self.l0 + t[:, 3] + t[:, 4] * q

MACHINES = (Delta, Planar, Hang)

# ---------------------------------------------------------------- session
@dataclasses.dataclass
class Fault:
    dq: np.ndarray; dl: np.ndarray; dE: np.ndarray; dt: np.ndarray; dr: np.ndarray
    def __add__(self, o): return Fault(*[a + b for a, b in zip(self.parts(), o.parts())])
    def __mul__(self, k): return Fault(*[k * a for a in self.parts()])
    def parts(self): return (self.dq, self.dl, self.dE, self.dt, self.dr)
def none(n): return Fault(np.zeros((n, 3)), np.zeros((n, 3)), np.zeros((n, 3, 3)), np.zeros((n, 3)), np.zeros((n, 3)))

class Session:
    RUNS, PTS = 6, 10
    def __init__(self, m, rng):
        self.m = m; x, run, dr, pay, st, feed = [], [], [], [], [], []
        k = 0
        for s in (0, 1):
            base = []
            for c in range(3):
                if c < 2:
                    a = np.linspace(0, 2 * np.pi, self.PTS, endpoint=False) + rng.uniform(0, 6)
                    r = (.85, .5)[c]
                    p = m.home + m.half * np.stack([r * np.cos(a), r * np.sin(a), (.8, -.6)[c] * np.cos((c + 1) * a + s)], -1)
                else:
                    p = m.home + m.half * rng.uniform(-.9, .9, (self.PTS, 3))
                base.append(p)
            for c, p in enumerate(base):
                for d in (1, -1):
                    x.append(p[::d]); n = len(p); run += [k] * n; dr += [d] * n; st += [s] * n
                    pay += [m.pay[(c + s) % 2]] * n; feed += [(1000., 2500.)[c % 2]] * n; k += 1
        self.x = np.concatenate(x); self.run = np.array(run); self.dir = np.array(dr); self.setup = np.array(st)
        self.pay = np.array(pay); self.feed = np.array(feed); n = len(self.x); self.n = n
        gap = 12. + 240. * (np.diff(self.run, prepend=0) > 0) + 900. * (np.diff(self.setup, prepend=0) > 0)
        self.t = np.cumsum(gap)
        self.q = m.ik(self.x, m.nom)
        d = m.P(self.x, m.nom) - m.E(self.q, m.nom); self.u = d / np.linalg.norm(d, axis=-1)[..., None]
        self.len = np.linalg.norm(d, axis=-1)
        # path direction of each drive
        step = np.diff(self.q, axis=0, prepend=self.q[:1] - 1e-9)
        first = np.searchsorted(self.run, self.run) == np.arange(n)
        step[first] = np.roll(step, -1, 0)[first]; self.sgn = np.sign(step)
        self.travel = np.cumsum(np.abs(np.diff(self.q, axis=0, prepend=self.q[:1])), 0)
    def forces(self, F):
        """Strut forces (n,3) that balance a force F (n,3) on the platform."""
        if self.m.planar:
            # wrench: Fx, Fy, moment about tool-platform origin
            r = self.m.P(self.x, self.m.nom)[..., :2] - self.x[:, None, :2]; u = self.u[..., :2]
            mom = r[..., 0] * u[..., 1] - r[..., 1] * u[..., 0]
            A = np.stack([u[..., 0], u[..., 1], mom], 1); b = np.stack([-F[:, 0], -F[:, 1], 0 * F[:, 0]], -1)
            return np.linalg.solve(A, b[..., None])[..., 0]
        return np.linalg.solve(np.swapaxes(self.u, 1, 2), -F[..., None])[..., 0]
    def weightload(self):
        F = np.zeros((self.n, 3)); F[:, 2] = -(self.m.weight + self.pay); return self.forces(F)
    def readings(self, th, reg, f):
        """(n, channels) m: reg (2, 6) shift and turn of the instrument by set-up."""
        m = self.m; x = m.fk(self.q, th, self.x, f)
        p = m.tool(x, m.tools[self.setup], f.dt)
        r = reg[self.setup]; w = r[:, 3:]
        p = p + np.cross(w, p) + r[:, :3] + f.dr
        return p[:, :len(m.chan)]

REG = np.array([1e-4] * 3 + [1e-4] * 3)

# ---------------------------------------------------------------- physics of faults
def each(s, dq=None, dl=None, legs=(0, 1, 2)):
    out = []
    for k in legs:
        f = none(s.n)
        if dq is not None: f.dq[:, k] = dq[:, k]
        if dl is not None: f.dl[:, k] = dl[:, k]
        out.append(f)
    return out
def course(s, rng):
    """Temperature above the start, K (n,): two lumped bodies, power in blocks."""
    t = np.arange(0, getattr(s, '_tmax', s.t.max()) + 10, 10.); on = np.repeat(rng.choice([.2, 1.], len(t) // 60 + 1), 60)[:len(t)]
    a, b = np.zeros(len(t)), np.zeros(len(t)); ta, tb = rng.uniform(600, 1200), rng.uniform(900, 2500)
    for k in range(1, len(t)):
        a[k] = a[k-1] + 10 / ta * (6 * on[k] - a[k-1]); b[k] = b[k-1] + 10 / tb * (a[k] - b[k-1])
    return np.interp(s.t, t, b)
def gear_eccentricity(s, rng):
    ratio = {"rotary3": 50., "slide3": rng.choice([7., 63.])}[s.m.name] if rng.random() < .5 else 1.
    return [p for k in range(3) for p in each(s, dq=np.sin(ratio * s.q + rng.uniform(0, 6, 3)) * 1e-5, legs=(k,))]
def backlash(s, rng): return each(s, dq=1e-5 * s.sgn)
def encoder_scale(s, rng): return each(s, dq=1e-4 * (s.q - s.m.q0))
def leg_thermal(s, rng):
    return [q for k in range(3) for q in each(s, dl=(1.15e-5 * course(s, rng))[:, None] * s.len, legs=(k,))]
def mount_drift(s, rng):
    out = []
    for st in (0, 1):
        on = s.setup == st; c = np.where(on, 1 - np.exp(-(s.t - (s.t[on].min() if on.any() else 0.)) / rng.uniform(400, 1500)), 0.)
        for ax in range(len(s.m.chan)):
            f = none(s.n); f.dr[:, ax] = 1e-5 * c; out.append(f)
    return out
def step(s, rng):
    k = rng.integers(2, 11); k = k + (k == 6); a = (s.run >= k) * 1e-5
    return each(s, dq=np.repeat(a[:, None], 3, 1))
def gravity(s, rng): return [sum(each(s, dl=-1e-7 * s.weightload()), none(s.n))]
def target_offset(s, rng):
    out = []
    for st in (0, 1):
        for ax in (0, 1):
            f = none(s.n); f.dt[:, ax] = 1e-5 * (s.setup == st); out.append(f)
    return out
def cable_stretch(s, rng): return each(s, dl=1e-7 * s.weightload() * -1 * s.len)
def drum_runout(s, rng): return each(s, dl=1e-5 * np.sin(s.q + rng.uniform(0, 6, 3)))
def cable_sag(s, rng):
    T = np.abs(s.weightload()); h = np.linalg.norm(s.u[..., :2], axis=-1)
    return [sum(each(s, dl=-1e-3 * (h * s.len) ** 2 * s.len / T ** 2 * 100), none(s.n))]
def pulley_radius(s, rng):
    d = s.m.anchor - s.x[:, None]; hor = np.linalg.norm(d[..., :2], axis=-1); ver = d[..., 2]; rho = .02
    c = np.hypot(hor - rho, ver); free = np.sqrt(c ** 2 - rho ** 2)
    wrap = np.pi - (np.arctan2(ver, hor - rho)) - np.arccos(rho / c) + np.pi / 2
    return each(s, dl=-(free + rho * wrap - s.len))
def post_compliance(s, rng):
    T = s.weightload(); out = []
    for k in range(3):
        f = none(s.n); pull = T[:, k, None] * s.u[:, k]; f.dE[:, k, :2] = -1e-7 * pull[:, :2]; out.append(f)
    return out
LISTED = {
    "rotary3": dict(gear_eccentricity=gear_eccentricity, backlash=backlash, encoder_scale=encoder_scale, leg_thermal=leg_thermal, mount_drift=mount_drift, step=step, gravity=gravity),
    "slide3": dict(gear_eccentricity=gear_eccentricity, backlash=backlash, encoder_scale=encoder_scale, leg_thermal=leg_thermal, mount_drift=mount_drift, step=step, target_offset=target_offset),
    "hang3": dict(encoder_scale=encoder_scale, cable_stretch=cable_stretch, drum_runout=drum_runout, cable_sag=cable_sag, pulley_radius=pulley_radius, post_compliance=post_compliance, mount_drift=mount_drift, step=step),
}
# -- that no list names
def thermal_bow(s, rng):
    return [q for k in range(3) for q in each(s, dq=1e-6 * np.repeat(course(s, rng)[:, None], 3, 1), legs=(k,))]
def worn_sector(s, rng):
    k = rng.integers(3); q0 = rng.choice(s.q[:, k]); w = .25 * np.ptp(s.q[:, k])
    return each(s, dq=1e-5 * np.exp(-((s.q - q0) / w) ** 4) * (1 + .5 * s.sgn), legs=(k,))
def axis_skew(s, rng):
    out = []
    for k in range(3):
        f = none(s.n); a = s.q[:, k]; c = a - (0 if s.m.name == "rotary3" else s.m.ang[k])
        if s.m.name == "rotary3": f.dE[:, k] = (1e-5 * np.sin(c))[:, None] * np.cross(s.m.out[k], E3[2])
        else: f.dl[:, k] = 1e-5 * (np.sin(c) ** 2)
        out.append(f)
    return out
def parallelogram_twist(s, rng):
    f = none(s.n); z = (s.x - s.m.home) / s.m.half; a, b, c = rng.normal(size=(3, 3))
    th = 1e-4 * (z @ np.stack([a, b, c], -1) + .7 * (z[:, :1] * z[:, 1:2]) * a)
    f.dt[:] = np.cross(th, s.m.tools[s.setup] - [0, 0, .05]); return [f]
def hose_pull(s, rng):
    an = s.m.home + np.append(rng.uniform(-.5, .5, 2), 0. if s.m.planar else .8)
    xx = s.x.copy()
    if s.m.planar: xx[:, 2] = 0
    d = an - xx; r = np.linalg.norm(d, axis=1); F = (20. * (r - .8 * r.min()) / r)[:, None] * d
    return [sum(each(s, dl=-1e-7 * s.forces(F)), none(s.n))]
def beam_bend(s, rng):
    f = none(s.n); st = np.array([2.5, -1.5, .5]) * rng.uniform(.7, 1.2); D = np.linalg.norm(s.x * [1, 1, 0 if s.m.planar else 1] - st, axis=1)
    g = np.sin(s.t / rng.uniform(500, 1500) + rng.uniform(0, 6)); f.dr[:, 1 if s.m.planar else 2] = 1e-6 * (D / D.mean()) ** 2 * g * 3
    return [f]
def slip_by_travel(s, rng):
    return each(s, dq=1e-5 * s.travel, legs=(int(rng.integers(3)),))
def cable_creep(s, rng):
    T = s.weightload() * -1; T = T - T[0]; y = np.zeros_like(T); tau = rng.uniform(300, 1200)
    for k in range(1, s.n):
        y[k] = T[k] + (y[k-1] - T[k]) * np.exp(-(s.t[k] - s.t[k-1]) / tau)
    return each(s, dl=1e-7 * y * s.len)
def drum_layer(s, rng):
    k = int(rng.integers(3)); q0 = np.quantile(s.q[:, k], rng.uniform(.4, .6))
    return each(s, dl=1e-4 * np.maximum(s.q - q0, 0), legs=(k,))
def swivel_offset(s, rng):
    d = s.x[:, None] - s.m.anchor; az = np.arctan2(d[..., 1], d[..., 0]) - np.arctan2(-s.m.anchor[:, 1], -s.m.anchor[:, 0]); out = []
    for k in range(3):
        # swivel axis lies e beside the eye: exit point runs on a circle; friction of the swivel lags it
        f = none(s.n); a = np.arctan2(d[:, k, 1], d[:, k, 0]); lag = .15 * s.dir
        f.dE[:, k, 0] = -1e-4 * np.sin(a + lag); f.dE[:, k, 1] = 1e-4 * np.cos(a + lag); out.append(f)
    return out
def winch_bearing(s, rng):
    """A winch's frame twists with the drum's lateral cable position: bump of two lobes a traverse."""
    k = int(rng.integers(3)); z = (s.q - s.q.mean(0)) / np.ptp(s.q, axis=0)
    return each(s, dl=1e-5 * np.sin(2 * np.pi * 1.7 * z + rng.uniform(0, 6)) * np.abs(s.weightload()) / 50., legs=(k,))
NEVER = {
    "rotary3": dict(thermal_bow=thermal_bow, worn_sector=worn_sector, axis_skew=axis_skew, parallelogram_twist=parallelogram_twist, hose_pull=hose_pull, beam_bend=beam_bend, slip_by_travel=slip_by_travel),
    "slide3": dict(thermal_bow=thermal_bow, worn_sector=worn_sector, hose_pull=hose_pull, beam_bend=beam_bend, slip_by_travel=slip_by_travel),
    "hang3": dict(cable_creep=cable_creep, drum_layer=drum_layer, swivel_offset=swivel_offset, beam_bend=beam_bend, slip_by_travel=slip_by_travel, winch_bearing=winch_bearing),
}

# ---------------------------------------------------------------- sight
NOISES = ("white", "correlated", "run")
class Sight:
    def __init__(self, s, noise, rng):
        self.s, self.noise = s, noise; m = s.m
        self.th = m.nom + rng.normal(size=len(m.nom)) * m.sd; self.reg = rng.normal(size=(2, 6)) * REG
        if m.planar: self.reg[:, 2:5] = 0
        self.clean = s.readings(self.th, self.reg, none(s.n))
        self.root = np.linalg.cholesky(self.cov())
        cols = []
        for k in range(len(m.nom)):
            a, b = (s.readings(self.th + sg * 1e-2 * m.sd[k] * np.eye(len(m.nom))[k], self.reg, none(s.n)) for sg in (1, -1))
            cols.append(((a - b) / 2e-2).T.ravel())
        for k in range(12):
            a = self.reg.ravel().copy(); a[k] += REG[k % 6]
            cols.append((s.readings(self.th, a.reshape(2, 6), none(s.n)) - self.clean).T.ravel())
        H = np.linalg.solve(self.root, np.stack(cols, -1)); self.p = H.shape[1]
        self.basis = np.linalg.qr(np.vstack([H, np.eye(self.p)]))[0]
    def cov(self):
        s = self.s; n = s.n; c = np.eye(n); same = s.run[:, None] == s.run
        if self.noise == "correlated":
            o = np.arange(n); c = .5 * np.eye(n) + .5 * same * .8 ** np.abs(o[:, None] - o)
        if self.noise == "run": c = np.eye(n) + .25 * same
        return s.m.sigma ** 2 * np.kron(np.eye(len(s.m.chan)), c)
    def diff(self, f):
        d = np.linalg.solve(self.root, (self.s.readings(self.th, self.reg, f) - self.clean).T.ravel())
        d = np.concatenate([d, np.zeros(self.p)]); return d - self.basis @ (self.basis.T @ d)
    def size(self, f): return float(np.linalg.norm(self.diff(f)))
    def draw_noise(self, rng): return (self.root @ rng.normal(size=self.clean.size)).reshape(self.clean.T.shape).T
CAP = {"rotary3": .3e-3, "slide3": .3e-3, "hang3": 5e-3}  # m, most that a fault moves a joint centre, a cable, a beam
def sized(sight, f, want):
    for _ in range(3): f = f * (want / max(sight.size(f), 1e-12))
    return f
RECIPES = []
def make(sight, maker, want, rng):
    state = rng.bit_generator.state
    parts = maker(sight.s, rng); w = rng.normal(size=len(parts))
    if rng.random() < .5 and len(parts) in (3,): w = w * (np.arange(len(parts)) == rng.integers(len(parts)))
    f = none(sight.s.n)
    for p, k in zip(parts, w): f = f + p * float(k)
    before = max(np.abs(a).max() for a in f.parts()); f = sized(sight, f, want)
    scale = max(np.abs(a).max() for a in f.parts()) / before
    RECIPES.append((maker, state, w, scale))
    return f
def peak(f, m): return max(m.arm * np.abs(f.dq).max(), np.abs(f.dl).max(), np.abs(f.dE).max(), np.abs(f.dt).max(), np.abs(f.dr).max())
def rest(d, cols):
    sc = np.linalg.norm(cols, axis=0).max() or 1.
    c = np.linalg.lstsq(cols / sc, d, rcond=1e-6)[0]; return float(np.linalg.norm(d - cols / sc @ c))
def library(sight, rng):
    """Columns of each listed cause, with both phases, ratios and several courses."""
    lib = {}
    for n, mk in LISTED[sight.s.m.name].items():
        ps = [p for _ in range({"gear_eccentricity": 8, "drum_runout": 4, "leg_thermal": 3, "mount_drift": 3}.get(n, 1)) for p in mk(sight.s, rng)]
        lib[n] = np.stack([sight.diff(sized(sight, p, 1.) if sight.size(p) > 1e-9 else p) for p in ps], -1)
    # a jump of any drive after any run, as `step` has it
    if "step" in lib:
        lib["step"] = np.stack([sight.diff(p) for k in range(1, 12) for p in each(sight.s, dq=np.repeat((1e-5 * (sight.s.run == k) if False else 1e-5 * (sight.s.run >= k))[:, None], 3, 1))], -1)
    return lib
def step_rest(d, cols):
    """Of one jump only."""
    return min(rest(d, cols[:, 3 * k:3 * k + 3]) for k in range(cols.shape[1] // 3))

KINDS = ("unknown", "null", "unknown", "single", "unknown", "unknown", "small", "unknown", "unknown")
SIZES = (6., 10., 20.)
def drawn(number):
    rng = np.random.default_rng([291129, number, 4]); m = MACHINES[number % 3]()
    kind = "small" if number >= 1000 else KINDS[(number // 3 + number) % 9]
    s = Session(m, rng); sight = Sight(s, str(rng.choice(NOISES)), rng); lib = library(sight, rng)
    eff, total = [], none(s.n); RECIPES.clear()
    if kind in ("single", "small", "unknown"):
        pool = NEVER[m.name] if kind == "unknown" else LISTED[m.name]
        name = str(rng.choice(sorted(pool))); want = float(rng.uniform(3, 6) if kind == "small" else rng.choice(SIZES))
        if kind == "unknown": want = float(rng.choice((10., 20., 30.)))
        for _ in range(12):
            f = make(sight, pool[name], want, rng)
            if peak(f, m) <= CAP[m.name]: break
            name = str(rng.choice(sorted(pool))); RECIPES.pop()
        else: raise ValueError("no fault of believable size")
        d = sight.diff(f); total = total + f
        r = {n: (step_rest(d, c) if n == "step" else rest(d, c)) for n, c in lib.items()}
        others = {n: v for n, v in r.items() if n != name}
        equal = {n for n, v in others.items() if v < 5.}
        leg = [int(k) + 1 for k in range(3) if np.abs(f.dq[:, k]).max() + np.abs(f.dl[:, k]).max() + np.abs(f.dE[:, k]).max() > 0]
        where = {"legs": leg} if 0 < len(leg) < 3 else {}
        listed = kind != "unknown"
        eff.append(dict(effect=name, listed=listed, sqrt_lambda=float(np.linalg.norm(d)), classes=sorted({name} | equal) if listed else None,
                        outside=min((v for n, v in others.items() if n not in equal), default=0.) if listed else None,
                        out_of_span=min(r.values()), rest=r, where=where, given_other=0.,
                        peak=dict(dq=float(np.abs(f.dq).max()), dl=float(np.abs(f.dl).max()), dE=float(np.abs(f.dE).max()), dr=float(np.abs(f.dr).max()), dt=float(np.abs(f.dt).max()))))
    elif number % 2: # healthy with faults too small to matter
        for n in rng.choice(sorted(LISTED[m.name]), 2, replace=False): total = total + make(sight, LISTED[m.name][str(n)], .8, rng)
    y = s.readings(sight.th, sight.reg, total) + sight.draw_noise(rng)
    label = dict(machine=m.name, kind="single" if kind == "small" else kind, small=kind == "small", law={"law": sight.noise}, effects=eff,
                 sqrt_lambda_total=sight.size(total) if eff else 0., closure={}, seed=number)
    return sight, total, label, y

# ---------------------------------------------------------------- files
def rows(sight, y, rng):
    s = sight.s; m = s.m
    cols = ["setup", "run", "order", "x_mm", "y_mm"] + (["phi_deg"] if m.planar else ["z_mm"]) + ["time_s", "direction", "feed_mm_min"]
    if not m.planar: cols.append("payload_N")
    if m.name == "hang3": cols += [f"tension_{k}_N" for k in (1, 2, 3)]
    cols += [f"read_{c}_mm" for c in m.chan]; out = [cols]
    T = -s.weightload() if m.name == "hang3" else None
    for n in range(s.n):
        first = int(np.searchsorted(s.run, s.run[n]))
        r = [f"nest{s.setup[n] + 1}", f"R{s.run[n] + 1:02d}", n - first + 1, f"{1e3 * s.x[n, 0]:.6f}", f"{1e3 * s.x[n, 1]:.6f}"]
        r += [f"{np.degrees(s.x[n, 2]):.8f}" if m.planar else f"{1e3 * s.x[n, 2]:.6f}", f"{s.t[n]:.1f}", int(s.dir[n]), s.feed[n]]
        if not m.planar: r.append(s.pay[n])
        if T is not None: r += [f"{v * (1 + .01 * rng.normal()):.1f}" for v in T[n]]
        out.append(r + [f"{1e3 * v:.6f}" for v in y[n]])
    return out
def study(m):
    inst = "planar_position" if m.planar else "pose_tracker_position"
    tol = "shift_x_mm = 0.1, shift_y_mm = 0.1, turn_z_mrad = 0.1" if m.planar else "shift_x_mm = 0.1, shift_y_mm = 0.1, shift_z_mm = 0.1, turn_x_mrad = 0.1, turn_y_mrad = 0.1, turn_z_mrad = 0.1"
    t = [f'schema = 1\nname = "{m.name}"\nseed = 1\n\n[machine]\nmodel = "machine.py:{m.name}"\n{m.drive}\n']
    for k, v in enumerate(m.tools):
        t.append(f'[[setup]]\nname = "nest{k+1}"\ninstrument = "{inst}"\ntool_mm = {[float(1e3 * a) for a in v]}\ntolerance = {{ {tol} }}\n')
    t.append("[noise]\n" + "\n".join(f"read_{c}_um = {1e6 * m.sigma}" for c in m.chan) + "\n")
    lo, hi = m.home - .6 * m.half, m.home + .6 * m.half
    r = lambda k, f=1e3: f"[{f*lo[k]:.4f}, {f*m.home[k]:.4f}, {f*hi[k]:.4f}]"
    t.append(f'[prediction]\nreference = "home"\nx_mm = {r(0)}\ny_mm = {r(1)}\n' + (f"phi_deg = {r(2, 180/np.pi)}\n" if m.planar else f"z_mm = {r(2)}\n"))
    t.append('[gap]\neffects = ["all"]\n\n[posterior]\nenabled = false\n\n[report]\nhtml = false\npdf = false\n')
    return "\n".join(t)
def grid(m):
    a = np.stack(np.meshgrid(*[[-.6, 0, .6]] * 3, indexing="ij"), -1).reshape(-1, 3); return m.home + a * m.half
def write(number, folder):
    """Study by machine (one file, compiled once), readings by case; the truth is returned, not written here."""
    sight, total, label, y = drawn(number); m = sight.s.m; folder.mkdir(parents=True, exist_ok=True)
    at = HERE / "studies" / m.name; at.mkdir(parents=True, exist_ok=True); st, rd = at / "case.study.toml", folder / "case.readings.csv"
    if not st.exists(): shutil.copyfile(HERE / "machine.py", at / "machine.py"); st.write_text(study(m))
    with rd.open("w", newline="") as fh: csv.writer(fh, lineterminator="\n").writerows(rows(sight, y, np.random.default_rng([number, 9])))
    return st, rd, label
def draw(number, folder):
    from benchmarks.harness.worlds import Case
    st, rd, label = write(number, folder)
    return Case(name=f"fourth {number}", study=st, readings=rd, label=label, stream=number)
def realised(number, sent, rng):
    """RMS error (3,) over the prediction grid, zeroed at home, where the controller has parameters `sent`, in states of the session."""
    sight, total, label, y = drawn(number); s, m = sight.s, sight.s.m; recipes = list(RECIPES); out = []
    for r in range(6):
        g = Grid(s, np.vstack([grid(m), m.home]), rng); f = none(g.n)
        for maker, state, w, scale in recipes:
            r2 = np.random.default_rng(); r2.bit_generator.state = state
            for p, k in zip(maker(g, r2), w): f = f + p * float(k * scale)
        x = m.fk(m.ik(g.x, sent), sight.th, g.x, f); e = x - g.x; out.append(e[:-1] - e[-1])
    e = np.concatenate(out); return np.sqrt((e ** 2).mean(0)), label
class Grid(Session):
    """Poses in use, all in the state of one reading of a session, its drives turning either way."""
    def __init__(self, s, x, rng):
        self.m, self.x, self.n = s.m, x, len(x); m = s.m; k = int(rng.integers(s.n)); one = np.ones(self.n)
        self.run, self.setup, self.pay, self.dir, self.feed = (np.full(self.n, v[k]) for v in (s.run, s.setup, s.pay, s.dir, s.feed))
        self.t = np.full(self.n, s.t[k]); self.t = self.t.astype(float); self._tmax = s.t.max()
        self.q = m.ik(x, m.nom); d = m.P(x, m.nom) - m.E(self.q, m.nom); self.len = np.linalg.norm(d, axis=-1); self.u = d / self.len[..., None]
        self.sgn = np.tile(rng.choice([-1., 1.], 3), (self.n, 1)); self.travel = np.tile(s.travel[k], (self.n, 1))
