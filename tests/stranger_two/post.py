
import sys, gen2, run
run.make = gen2.make
which = sys.argv[1]
if which == 'slope_legs':      # slope singles, legs only, joint zero and tilt drawn at the STATED sd
    gen2.POST = dict(style='legs', D=lambda r: dict(jz=r.normal(0,.02), tilt=r.normal(0,.04)))
    for i in range(6): run.one('singles', 5+12*i, 901, 'post_slope')
if which == 'rigtilt':         # nothing hidden, but joint zero -s and sensor tilt +s, within the stated uncertainty
    def D(r):
        s = r.choice([-1,1])*r.uniform(.025,.04); return dict(jz=-s, tilt=s)
    gen2.POST = dict(style='legs', D=D)
    for i in range(6): run.one('nulls', i, 902, 'post_rigtilt')
if which == 'weak_clean':      # strength only, other errors as drawn but coefficients within .5 sd
    pass
