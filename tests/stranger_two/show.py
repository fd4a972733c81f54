import json, sys
for d in sys.argv[1:]:
    r=json.load(open(d+'/d/report.json')); t=json.load(open(d+'/truth.json'))
    print('=====',d,t['cause'],t['value'],t['medium'],'csd',t['coefficient_sd'],'Ty',t['Ty'],t['style'],t['shapes'],r['verdict'],[(c['id'],c['value'],c['ci95']) for c in r['causes']]); print(r['summary'][:900])
    print('withheld',json.dumps(r['withheld'])[:1200])
    for e in sorted(r['evidence'],key=lambda e:-e['elpd'])[:9]: print('  ',e['model'],e['ids'],e['terms'],round(e['elpd'],1),round(e['difference'],1),round(e['standard_error'],1))
    e=[e for e in r['evidence'] if e['model']=='plain'][0]; print('   plain',round(e['difference'],1),round(e['standard_error'],1))
    for n in r['nuisances']:
        if abs(n['value'])>1.5*n['sd']: print('   nuis',n['id'],n['of'],round(n['value'],5),round(n['sd'],5))
    print({a:t['dirt'][a] for a in ('bed','day','grain','white','late','hyst','sat','outl','jz','att','tilt','dz','jitter','gain','xt','size')})
    print('lof',r['lack_of_fit'],'gain',r['gain']['reduction'],r['gain']['ci95'])
