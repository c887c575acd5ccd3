var F=Math.PI/2-.001;function w({distortionModel:s,distortion:t}){return s==="fisheye"?G(t):N(t)}function N(s){let[t,n,a,e,i,c,l,p]=Array.from({length:8},(o,u)=>s[u]??0),m=o=>{let u=1+o*(c+o*(l+o*p)),r=(1+o*(t+o*(n+o*i)))/u,f=(t+o*(2*n+3*o*i)-r*(c+o*(2*l+3*o*p)))/u;return[r,f]},d=L(o=>{let[u,r]=m(o*o);return u>0&&u+2*o*o*r>0},16);return(o,u)=>{let[r,f]=[o,u];for(let h=15;;h--){let x=r*r+f*f,[y,b]=m(x),g=r*y+2*a*r*f+e*(x+2*r*r)-o,M=f*y+a*(x+2*f*f)+2*e*r*f-u,S=Math.abs(g)+Math.abs(M);if(h===0||!(S>1e-12))return S<1e-6&&x<d*d?[r,f]:null;let A=y+2*r*r*b+2*a*f+6*e*r,C=y+2*f*f*b+6*a*f+2*e*r,v=2*r*f*b+2*a*r+2*e*f,P=A*C-v*v;r-=(C*g-v*M)/P,f-=(A*M-v*g)/P}}}function G([s,t,n,a]){let e=c=>{let l=c*c;return 1+l*(3*s+l*(5*t+l*(7*n+l*9*a)))},i=L(c=>e(c)>0,F);return(c,l)=>{let p=Math.hypot(c,l);if(p===0)return[c,l];let m=Math.min(p,i);for(let d=15;;d--){let o=m*m,u=m*(1+o*(s+o*(t+o*(n+o*a))))-p;if(d===0||!(Math.abs(u)>1e-12)){let r=Math.tan(m)/p;return Math.abs(u)<1e-6?[c*r,l*r]:null}m=Math.min(i,Math.max(0,m-u/e(m)))}}}function L(s,t){for(let n=1;n<=4096;n++){if(s(n*t/4096))continue;let[a,e]=[(n-1)*t/4096,n*t/4096];for(let i=0;i<50;i++){let c=(a+e)/2;s(c)?a=c:e=c}return a}return t}var H=2**-12,j=2**-18,I=3,_=2,U=8192;var E=-1e9;function R(s,t,n){let a=n===1?.5:0,e=h=>n===1?h:Math.ceil(h/n)+1,[i,c]=[e(s.width),e(s.height)],l=new Float32Array(2*i*c).fill(E),p=w(t),m=[new T(s.width),new T(s.height)];for(let h=0,x=0;h<c;h++){let y=(a+h*n-s.cy)/s.fy;for(let b=0;b<i;b++,x+=2){let g=p((a+b*n-s.cx)/s.fx,y);g!==null&&(l[x]=g[0]*s.fx+s.cx,l[x+1]=g[1]*s.fy+s.cy,m[0].add(l[x]),m[1].add(l[x+1]))}}let[[d,o],[u,r]]=[m[0].pixels(),m[1].pixels()];for(let h=0;h<l.length;h+=2)l[h]!==E&&(l[h]-=d,l[h+1]-=u);let f={width:o-d,height:r-u,cx:s.cx-d,cy:s.cy-u};return{camera:{...s,...f,recording:null},cell:n,first:a,columns:i,rows:c,positions:l}}var T=class{constructor(t){this.size=t}size;least=1/0;most=-1/0;add(t){t<this.least&&(this.least=t),t>this.most&&(this.most=t)}pixels(){let{size:t}=this,n=Math.max(0,Math.floor(Math.min((I-1)*t,U-t)/2)),a=Math.max(Math.floor(this.least)-_,-n),e=Math.min(Math.ceil(this.most)+_,t+n);return a<e?[a,e]:[0,t]}};var D=`#version 300 es
precision highp float;
precision highp sampler2D;
uniform sampler2D accumulated, positions;
uniform vec3 odds;
uniform vec4 background, place;
uniform vec2 size;
uniform vec2 focal, centre;
uniform float cell, falloff;
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
void main() {
vec2 pixel = vec2(gl_FragCoord.x, size.y - gl_FragCoord.y);
result = vec4(0.0, 0.0, 0.0, background.a);
if (any(lessThan(pixel, place.xy)) || any(greaterThan(pixel, place.zw))) return;
vec2 from = source(pixel), tangent = (from - centre) / focal;
vec4 seen = bent ? through(from) : at(ivec2(pixel));
float light = from.x < -1e8 ? 1.0 : 1.0 + falloff * dot(tangent, tangent);
vec3 factors = odds / (light * light);
float covered = max(clamp(seen.a, 0.0, 1.0), background.a);
vec3 v = seen.rgb / max(covered, 1e-6);
vec3 inside = clamp(v, 0.0, 1.0);
vec3 recorded = min(factors * inside / (1.0 + (factors - 1.0) * inside), 1.0);
result = vec4(clamp(mix(v, recorded, equal(v, inside)), 0.0, 1.0) * covered, covered);
}
`;var z=8,O=class{constructor(t,n){this.gl=t;this.program=n(D),this.texture=t.createTexture()}gl;program;texture;plan=null;planOf="";seenBy(t,{lens:n}){if(n===null)return t;let{width:a,height:e,fx:i,fy:c,cx:l,cy:p}=t,m=JSON.stringify([a,e,i,c,l,p,n.distortionModel,n.distortion]);(this.plan===null||this.planOf!==m)&&(this.plan=R(t,n,z),this.plan.positions.includes(E)&&(this.plan=R(t,n,1)),this.planOf=m,this.upload(this.plan));let{width:d,height:o,cx:u,cy:r}=this.plan.camera;return{...t,width:d,height:o,cx:u,cy:r}}use(t,n,a){let{gl:e,program:i}=this,{lens:c,odds:l,falloff:p,left:m,top:d,width:o,height:u}=n,r=this.seenBy(t,n);e.activeTexture(e.TEXTURE1),e.bindTexture(e.TEXTURE_2D,this.texture),e.activeTexture(e.TEXTURE0),e.useProgram(i.program),e.uniform1i(i.uniform("accumulated"),0),e.uniform1i(i.uniform("positions"),1),e.uniform4fv(i.uniform("background"),a),e.uniform3fv(i.uniform("odds"),l??[1,1,1]),e.uniform4f(i.uniform("place"),m,d,m+o,d+u),e.uniform2f(i.uniform("size"),t.width,t.height),e.uniform2f(i.uniform("focal"),r.fx,r.fy),e.uniform2f(i.uniform("centre"),r.cx,r.cy),e.uniform1f(i.uniform("falloff"),p),e.uniform1f(i.uniform("cell"),this.plan?.cell??1),e.uniform1i(i.uniform("bent"),c===null?0:1)}dispose(){this.gl.deleteTexture(this.texture),this.gl.deleteProgram(this.program.program)}upload({columns:t,rows:n,positions:a}){let{gl:e}=this;e.activeTexture(e.TEXTURE1),e.bindTexture(e.TEXTURE_2D,this.texture),e.texImage2D(e.TEXTURE_2D,0,e.RG32F,t,n,0,e.RG,e.FLOAT,a);for(let i of[e.TEXTURE_MIN_FILTER,e.TEXTURE_MAG_FILTER])e.texParameteri(e.TEXTURE_2D,i,e.NEAREST);e.activeTexture(e.TEXTURE0)}};export{O as RecordedPass};
