var O=Math.PI/2-.001;function C({distortionModel:s,distortion:t}){return s==="fisheye"?z(t):N(t)}function N(s){let[t,n,a,e,o,u,l,d]=Array.from({length:8},(r,f)=>s[f]??0),m=r=>{let f=1+r*(u+r*(l+r*d)),i=(1+r*(t+r*(n+r*o)))/f,c=(t+r*(2*n+3*r*o)-i*(u+r*(2*l+3*r*d)))/f;return[i,c]},p=P(r=>{let[f,i]=m(r*r);return f>0&&f+2*r*r*i>0},16);return(r,f)=>{let[i,c]=[r,f];for(let h=15;;h--){let x=i*i+c*c,[g,b]=m(x),v=i*g+2*a*i*c+e*(x+2*i*i)-r,M=c*g+a*(x+2*c*c)+2*e*i*c-f,w=Math.abs(v)+Math.abs(M);if(h===0||!(w>1e-12))return w<1e-6&&x<p*p?[i,c]:null;let A=g+2*i*i*b+2*a*c+6*e*i,L=g+2*c*c*b+6*a*c+2*e*i,y=2*i*c*b+2*a*i+2*e*c,S=A*L-y*y;i-=(L*v-y*M)/S,c-=(A*M-y*v)/S}}}function z([s,t,n,a]){let e=u=>{let l=u*u;return 1+l*(3*s+l*(5*t+l*(7*n+l*9*a)))},o=P(u=>e(u)>0,O);return(u,l)=>{let d=Math.hypot(u,l);if(d===0)return[u,l];let m=Math.min(d,o);for(let p=15;;p--){let r=m*m,f=m*(1+r*(s+r*(t+r*(n+r*a))))-d;if(p===0||!(Math.abs(f)>1e-12)){let i=Math.tan(m)/d;return Math.abs(f)<1e-6?[u*i,l*i]:null}m=Math.min(o,Math.max(0,m-f/e(m)))}}}function P(s,t){for(let n=1;n<=4096;n++){if(s(n*t/4096))continue;let[a,e]=[(n-1)*t/4096,n*t/4096];for(let o=0;o<50;o++){let u=(a+e)/2;s(u)?a=u:e=u}return a}return t}var j=2**-12,B=2**-18,V=2**-12,q=2**-16;var G=3,_=2,I=8192;var E=-1e9;function R(s,t,n){let a=n===1?.5:0,e=h=>n===1?h:Math.ceil(h/n)+1,[o,u]=[e(s.width),e(s.height)],l=new Float32Array(2*o*u).fill(E),d=C(t),m=[new T(s.width),new T(s.height)];for(let h=0,x=0;h<u;h++){let g=(a+h*n-s.cy)/s.fy;for(let b=0;b<o;b++,x+=2){let v=d((a+b*n-s.cx)/s.fx,g);v!==null&&(l[x]=v[0]*s.fx+s.cx,l[x+1]=v[1]*s.fy+s.cy,m[0].add(l[x]),m[1].add(l[x+1]))}}let[[p,r],[f,i]]=[m[0].pixels(),m[1].pixels()];for(let h=0;h<l.length;h+=2)l[h]!==E&&(l[h]-=p,l[h+1]-=f);let c={width:r-p,height:i-f,cx:s.cx-p,cy:s.cy-f};return{camera:{...s,...c,recording:null},cell:n,first:a,columns:o,rows:u,positions:l}}var T=class{constructor(t){this.size=t}size;least=1/0;most=-1/0;add(t){t<this.least&&(this.least=t),t>this.most&&(this.most=t)}pixels(){let{size:t}=this,n=Math.max(0,Math.floor(Math.min((G-1)*t,I-t)/2)),a=Math.max(Math.floor(this.least)-_,-n),e=Math.min(Math.ceil(this.most)+_,t+n);return a<e?[a,e]:[0,t]}};var D=`#version 300 es
precision highp float;
precision highp sampler2D;
uniform sampler2D accumulated, positions, lamps;
uniform vec3 odds;
uniform vec4 background, place;
uniform vec2 size;
uniform vec2 focal, centre;
uniform float cell, falloff;
uniform vec3 turns;
uniform bool bent;
out vec4 result;
vec4 at(ivec2 pixel) {
ivec2 all = textureSize(accumulated, 0);
pixel = clamp(pixel, ivec2(0), all - 1);
vec4 sum = texelFetch(accumulated, ivec2(pixel.x, all.y - 1 - pixel.y), 0);
return vec4(sum.rgb, 1.0 - sum.a) + sum.a * background;
}
vec4 weights(float t) {
const float A = -0.75;
vec3 d = vec3(t + 1.0, t, 1.0 - t);
float far = ((A * d.x - 5.0 * A) * d.x + 8.0 * A) * d.x - 4.0 * A;
vec2 near = ((A + 2.0) * d.yz - (A + 3.0)) * d.yz * d.yz + 1.0;
return vec4(far, near, 1.0 - far - near.x - near.y);
}
vec2 source(vec2 pixel) {
if (!bent) return pixel;
vec2 corner = floor(pixel / cell), part = pixel / cell - corner;
ivec2 first = ivec2(corner);
vec2 a = texelFetch(positions, first, 0).xy, b = texelFetch(positions, first + ivec2(1, 0), 0).xy;
vec2 c = texelFetch(positions, first + ivec2(0, 1), 0).xy, d = texelFetch(positions, first + 1, 0).xy;
return cell == 1.0 ? a : mix(mix(a, b, part.x), mix(c, d, part.x), part.y);
}
vec4 through(vec2 position) {
vec2 from = position - 0.5;
if (any(lessThan(from, vec2(0.0))) || any(greaterThan(from, vec2(textureSize(accumulated, 0) - 1)))) return background;
ivec2 middle = ivec2(floor(from));
vec4 across = weights(from.x - float(middle.x)), down = weights(from.y - float(middle.y));
vec4 sum = vec4(0.0);
for (int j = 0; j < 4; ++j) for (int i = 0; i < 4; ++i) sum += across[i] * down[j] * at(middle + ivec2(i - 1, j - 1));
return sum;
}
vec3 lampLight(vec2 share) {
ivec2 size = textureSize(lamps, 0) / ivec2(2, 1);
vec2 at = clamp(share * vec2(size) - 0.5, vec2(0.0), vec2(size - 1)), part = fract(at);
ivec2 first = ivec2(floor(at)), last = min(first + 1, size - 1);
vec3 wave = vec3(0.0);
float turn = 6.283185307179586 * fract(turns.x + turns.y * share.y);
for (int k = 0; k < 2; ++k) {
ivec4 x = ivec4(2 * first.x + k, 2 * last.x + k, first.y, last.y);
vec3 upper = mix(texelFetch(lamps, x.xz, 0).rgb, texelFetch(lamps, x.yz, 0).rgb, part.x);
vec3 lower = mix(texelFetch(lamps, x.xw, 0).rgb, texelFetch(lamps, x.yw, 0).rgb, part.x);
wave += (k == 0 ? sin(turn) : cos(turn)) * mix(upper, lower, part.y);
}
return clamp(1.0 + wave, 0.125, 8.0);
}
void main() {
vec2 pixel = vec2(gl_FragCoord.x, size.y - gl_FragCoord.y);
result = vec4(0.0, 0.0, 0.0, background.a);
if (any(lessThan(pixel, place.xy)) || any(greaterThan(pixel, place.zw))) return;
vec2 from = source(pixel), tangent = (from - centre) / focal;
vec4 seen = bent ? through(from) : at(ivec2(pixel));
float light = from.x < -1e8 ? 1.0 : 1.0 + falloff * dot(tangent, tangent);
vec3 factors = odds / (light * light);
if (turns.z > 0.0) factors *= lampLight((pixel - place.xy) / (place.zw - place.xy));
float covered = max(clamp(seen.a, 0.0, 1.0), background.a);
vec3 v = seen.rgb / max(covered, 1e-6);
vec3 inside = clamp(v, 0.0, 1.0);
vec3 recorded = min(factors * inside / (1.0 + (factors - 1.0) * inside), 1.0);
result = vec4(clamp(mix(v, recorded, equal(v, inside)), 0.0, 1.0) * covered, covered);
}
`;var U=8,k={turns:0,turnsDown:0,columns:1,rows:1,cells:new Float32Array(8)},F=class{constructor(t,n){this.gl=t;this.program=n(D),this.texture=t.createTexture(),this.lampCells=t.createTexture()}gl;program;texture;lampCells;plan=null;planOf="";seenBy(t,{lens:n}){if(n===null)return t;let{width:a,height:e,fx:o,fy:u,cx:l,cy:d}=t,m=JSON.stringify([a,e,o,u,l,d,n.distortionModel,n.distortion]);(this.plan===null||this.planOf!==m)&&(this.plan=R(t,n,U),this.plan.positions.includes(E)&&(this.plan=R(t,n,1)),this.planOf=m,this.upload(this.plan));let{width:p,height:r,cx:f,cy:i}=this.plan.camera;return{...t,width:p,height:r,cx:f,cy:i}}use(t,n,a){let{gl:e,program:o}=this,{lens:u,odds:l,falloff:d,lamps:m,left:p,top:r,width:f,height:i}=n,c=this.seenBy(t,n);e.activeTexture(e.TEXTURE1),e.bindTexture(e.TEXTURE_2D,this.texture),this.uploadLamps(m??k),e.activeTexture(e.TEXTURE0),e.useProgram(o.program),e.uniform1i(o.uniform("accumulated"),0),e.uniform1i(o.uniform("positions"),1),e.uniform1i(o.uniform("lamps"),2),e.uniform3f(o.uniform("turns"),m?.turns??0,m?.turnsDown??0,m===null?0:1),e.uniform4fv(o.uniform("background"),a),e.uniform3fv(o.uniform("odds"),l??[1,1,1]),e.uniform4f(o.uniform("place"),p,r,p+f,r+i),e.uniform2f(o.uniform("size"),t.width,t.height),e.uniform2f(o.uniform("focal"),c.fx,c.fy),e.uniform2f(o.uniform("centre"),c.cx,c.cy),e.uniform1f(o.uniform("falloff"),d),e.uniform1f(o.uniform("cell"),this.plan?.cell??1),e.uniform1i(o.uniform("bent"),u===null?0:1)}dispose(){this.gl.deleteTexture(this.texture),this.gl.deleteTexture(this.lampCells),this.gl.deleteProgram(this.program.program)}upload({columns:t,rows:n,positions:a}){let{gl:e}=this;e.activeTexture(e.TEXTURE1),e.bindTexture(e.TEXTURE_2D,this.texture),e.texImage2D(e.TEXTURE_2D,0,e.RG32F,t,n,0,e.RG,e.FLOAT,a),this.unfiltered(),e.activeTexture(e.TEXTURE0)}uploadLamps({columns:t,rows:n,cells:a}){let{gl:e}=this;e.activeTexture(e.TEXTURE2),e.bindTexture(e.TEXTURE_2D,this.lampCells),e.texImage2D(e.TEXTURE_2D,0,e.RGBA32F,2*t,n,0,e.RGBA,e.FLOAT,a),this.unfiltered()}unfiltered(){let{gl:t}=this;for(let n of[t.TEXTURE_MIN_FILTER,t.TEXTURE_MAG_FILTER])t.texParameteri(t.TEXTURE_2D,n,t.NEAREST)}};export{F as RecordedPass};
