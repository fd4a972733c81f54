"""My own li2013 force law for thin plates and legs in the vertical plane, with the catalogue's mechanisms."""
import numpy as np
NAMES = ['A00','A10','B11','B01','Bm11','C11','C01','Cm11','D10']
MEDIA = {'poppy-loose': (np.array([.051,.047,.053,.083,.020,-.026,.057,0,.025])*1e6, 638.),
         'poppy-close': (np.array([.094,.092,.092,.151,.035,-.039,.086,.018,.046])*1e6, 680.)}
GEN = np.array([.206,.169,.212,.358,.055,-.124,.253,.007,.088])*1e6
MEDIA['glass-beads'] = (.33*GEN, 1500.); MEDIA['plastic-pellets'] = (.111*GEN, 560.); MEDIA['quikrete-medium'] = (2.02*GEN, 1600.)

def alpha(c, b, g):
    A00,A10,B11,B01,Bm,C11,C01,Cm,D = c
    az = A00 + A10*np.cos(2*b) + B11*np.sin(2*b+g) + B01*np.sin(g) + Bm*np.sin(-2*b+g)
    ax = C11*np.cos(2*b+g) + C01*np.cos(g) + Cm*np.cos(-2*b+g) + D*np.sin(2*b)
    return ax, az

def segment_forces(c, rho, x, z, vx, vz, tx, tz, area, width, an, m, xbed=0., pass_=1, dx=0., hook=None):
    """arrays (T,S); an = d v_n/dt for the normal (tz,-tx) (to be signed). Returns fx, fz per segment."""
    sg = m.get('slope', 0.); cs, sn = np.cos(sg), np.sin(sg)
    rot = lambda a, b: (cs*a + sn*b, -sn*a + cs*b)
    depth = np.maximum((x*np.tan(sg) - z)*cs, 0.); sub = depth > 0
    VX, VZ = rot(vx, vz); TX, TZ = rot(tx, tz)
    s = np.where(VX >= 0, 1., -1.)
    gam = np.arctan2(-VZ, np.abs(VX)); beta = np.arctan2(TZ, TX*s)     # mirrored tangent
    ax, az = alpha(c, beta, gam)
    fx, fz = -s*ax, az
    p = 1 + m.get('depth_power', 0.); d = .02*(np.maximum(depth, 1e-12)/.02)**p if p != 1 else depth
    nx, nz = TZ, -TX; vn = VX*nx + VZ*nz; sgn = np.where(vn >= 0, 1., -1.); nx, nz, vn, an = nx*sgn, nz*sgn, vn*sgn, an*sgn
    speed = np.hypot(VX, VZ)
    k = 1 + m.get('scale', 0.)
    k = k*np.maximum(1 + m.get('packing_grad', 0.)*(xbed + x)/.1, .2)*np.maximum(1 + m.get('rate_log', 0.)*np.log(1+speed/.01), .2)
    if pass_ >= 2: k = k*(1 - m.get('footprint', 0.)*np.exp(-dx/.03))
    fx, fz = fx*d*k, fz*d*k
    if m.get('friction_clip', 0.) > 0:
        mu = 1/m['friction_clip']; q = fx*nx + fz*nz; ux, uz = fx - q*nx, fz - q*nz
        t = np.hypot(ux, uz); r = np.minimum(1, mu*np.abs(q)/np.maximum(t, 1e-12)); fx, fz = q*nx + r*ux, q*nz + r*uz
    pn = m.get('inertial_drag', 0.)*rho*vn**2 + m.get('added_mass', 0.)*rho*width*an + m.get('cohesion', 0.)*np.tanh(vn/1e-3)
    if hook is not None: fx, fz, pn = hook(fx, fz, pn, dict(depth=depth, vn=vn, speed=speed, rho=rho, w=width, x=x, nx=nx, nz=nz, gam=gam, beta=beta, an=an))
    fx, fz = (fx - pn*nx)*area*sub, (fz - pn*nz)*area*sub
    return cs*fx - sn*fz, sn*fx + cs*fz

def pieces(chord, xi, n):
    """polyline hip -> knee -> tip in the frame of the leg (u = down along hip-tip, w = toward +x at theta 0)."""
    k = chord*np.cos(xi); knee = np.array([k*np.cos(xi), k*np.sin(xi)]); P = [np.zeros(2), knee, np.array([chord, 0.])]
    if abs(xi) < 1e-9: P = [P[0], P[2]]
    mids, tang, L = [], [], []
    for a, b in zip(P[:-1], P[1:]):
        e = (np.arange(n)+.5)/n; mids.append(a + e[:, None]*(b-a)); l = np.hypot(*(b-a)); L.append(np.full(n, l/n)); tang.append(np.tile((b-a)/l, (n, 1)))
    return np.vstack(mids), np.vstack(tang), np.concatenate(L)

def leg(c, rho, shape, hip_z, th, om, al, m, n=120, hook=None, **kw):
    W = shape['width']
    def go(xi):
        P, T, L = pieces(shape['chord'], xi, n)
        S, C = np.sin(th)[:, None], np.cos(th)[:, None]
        # u direction at theta: (sin th, -cos th); w direction: (cos th, sin th)
        x = P[:, 0]*S + P[:, 1]*C; z0 = -P[:, 0]*C + P[:, 1]*S
        tx = T[:, 0]*S + T[:, 1]*C; tz = -T[:, 0]*C + T[:, 1]*S
        o = om[:, None]; vx, vz = -o*z0, o*x                 # tip (0,-R): vx = om R
        r_n = (-z0)*tz + x*(-tx)                             # v_n/om for the normal (tz,-tx)
        h = np.asarray(hip_z)*np.ones(len(th)); z = z0 + h[:, None]
        fx, fz = segment_forces(c, rho, x, z, vx, vz, tx, tz, L*W, W, al[:, None]*r_n, m, hook=hook, **kw)
        return np.stack([fx.sum(1), fz.sum(1), (x*fz - z0*fx).sum(1)])
    xi = np.radians(shape['xi_deg']); F = go(xi); chi = m.get('concave_fill', 0.)
    if chi:
        lead = (om*xi < 0)
        F = np.where(lead, (1-chi)*F + chi*go(0.), F)
    return F

def plate(c, rho, shape, x, z, vx, vz, beta, acc, m, n=100, hook=None, **kw):
    """beta array as published (mirrored when vx<0); acc (ax, az) arrays"""
    s = np.where(vx >= 0, 1., -1.); tx, tz = (np.cos(beta)*s)[:, None], np.sin(beta)[:, None]
    l = shape['length']; e = ((np.arange(n)+.5)/n - .5)*l; o = np.ones((1, n))
    X, Z = e*tx, e*tz
    an = (acc[0][:, None]*tz - acc[1][:, None]*tx)*o
    fx, fz = segment_forces(c, rho, x[:, None]+X, z[:, None]+Z, vx[:, None]*o, vz[:, None]*o, tx*o, tz*o, l/n*shape['width'], shape['width'], an, m, hook=hook, **kw)
    return np.stack([fx.sum(1), fz.sum(1), (X*fz - Z*fx).sum(1)])
